"""Sentence grammar of English; see grammar.py."""

from talkingeyes.synthesis.grammars.rules import Grammar, rules

ENGLISH: Grammar = rules(
    """
    statement:
        | {who} {did} {thing}.
        | {who} {was} {feeling}.
        | {who} {did} {thing} {where}.
        | {when}, {who} {did} {thing} {where}.
        | {who} {did} {thing}, but {who} {was} {feeling}.
        | {view} {who} {did} {thing} {when}.
        | if the {weather} lasts, {who} will {do} {thing} {where}.
        | {who} {was} {feeling} {when}, so nobody {did} {thing}.
    question:
        | did {who} {do} {thing} {where}?
        | why would {who} {do} {thing} {when}?
        | when you were {where}, did {who} {do} {thing}?
        | who {did} {thing} {where} {when}?
        | do you think that {who} {was} {feeling} {when}?
    list:
        | {who} packed {item}, {item}, {item} and {item}.
        | on the table {where} were {item}, {item} and {item}.
        | first we {did} {thing}, then {who} {did} {thing}, and at last there was only {item}.
        | you will need {item}, {item}, {item}, and perhaps {item}.
    who: the {kind} {person} | my {person} | that {kind} {person} | the {person} from the {place} | our
        neighbour | the two brothers | most of the children
    kind: old | young | quiet | cheerful | clever | tired | famous | careful | lazy | friendly | tall | shy
    person: gardener | teacher | pilot | baker | doctor | painter | sailor | farmer | singer | cousin | driver |
        carpenter | librarian | nurse | goldsmith | grandmother | fisherman | tailor
    did: found | lost | painted | mended | carried | forgot | sold | noticed | borrowed | cleaned | hid |
        described | measured | opened
    do: find | lose | paint | mend | carry | forget | sell | notice | borrow | clean | hide | describe | measure
        | open
    thing: the {look} {object} | this {look} {object} | another {object} | every {object} | both of the boats |
        the last {object} | some of the letters
    look: wooden | yellow | broken | heavy | silver | empty | narrow | dusty | green | strange | tiny | round
    object: window | bicycle | basket | piano | lantern | suitcase | mirror | ladder | kettle | umbrella | drum
        | chair | bottle | carpet | compass | wardrobe
    where: in the {place} | behind the {place} | near the {place} | on the way to the {place} | outside the
        {place}
    place: harbour | village | kitchen | station | market | museum | forest | library | valley | garden | bakery
        | school | theatre | mountain | lighthouse
    when: yesterday | last summer | before breakfast | on Monday morning | after the storm | a week ago | at
        midnight | during the holidays | a long time ago | just before the meeting | in the winter | this
        afternoon
    was: seemed | looked | felt | stayed
    feeling: happy | surprised | very hungry | a little worried | rather proud | completely lost | quite calm |
        angry | not at all ready | half asleep | terribly bored | grateful
    view: I believe that | everybody knows that | somebody told me that | it is true that | we were glad that |
        nobody remembers that | the newspaper said that | I was surprised that
    weather: rain | sunshine | wind | snow | fog | heat
    item: bread | apples | a map | two candles | warm socks | honey | a bottle of water | some string | cheese |
        a torch | three pencils | a woollen blanket | matches | coffee | an old newspaper | onions | a pocket
        knife | soap
    filler: um | uh | er | um
    """
)
