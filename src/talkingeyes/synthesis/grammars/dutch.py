"""Sentence grammar of Dutch; see grammar.py."""

from talkingeyes.synthesis.grammars.rules import Grammar, rules

DUTCH: Grammar = rules(
    """
    statement:
        | {who} heeft {thing} {did}.
        | {who} was {feeling}.
        | {who} heeft {where} {thing} {did}.
        | {when} heeft {who} {where} {thing} {did}.
        | {view} {who} {when} {thing} heeft {did}.
        | {who} heeft {thing} {did}, maar niemand keek.
        | {who} was {feeling}, want {when} heeft niemand {thing} {did}.
    question:
        | heeft {who} {where} {thing} {did}?
        | waarom heeft {who} {when} {thing} {did}?
        | weet je of {who} {when} {thing} heeft {did}?
    list:
        | {who} heeft {item}, {item}, {item} en {item} ingepakt.
        | op tafel lagen {item}, {item} en {item}.
        | we hebben nog {item}, {item}, {item} en misschien {item} nodig.
    who: de {kind} {person} | mijn {person} | onze {person} | een {person} uit het dorp | die {kind} {person}
    kind: oude | jonge | stille | vrolijke | moeie | beroemde | luie | vriendelijke | lange | slimme
    person: bakker | leraar | piloot | schilder | tuinman | visser | kleermaker | zanger | buurman | boer |
        timmerman | neef
    did: gevonden | verloren | verkocht | vergeten | verstopt | gepoetst | gemeten | beschreven | gedragen |
        geopend
    thing: de {look} {object} | een {look} {object} | elke {object} | zijn {object}
    look: oude | kleine | groene | zware | lege | ronde | vreemde | stoffige | zilveren
    object: mand | koffer | spiegel | kast | paraplu | sleutel | stoel | ketel | brief | hamer | trommel | lamp
    where: in het {place} | achter het {place} | naast het {place} | op weg naar het {place}
    place: dorp | bos | museum | theater | station | raadhuis | park | kasteel | strand | plein
    when: gisteren | vanmorgen | vorige zomer | voor het ontbijt | na de storm | een week geleden | om
        middernacht | in de winter
    feeling: blij | verrast | erg hongerig | een beetje bezorgd | best trots | heel rustig | boos | moe |
        dankbaar
    view: ik geloof dat | iedereen weet dat | iemand vertelde dat | het is waar dat
    item: brood | appels | een kaart | twee kaarsen | warme sokken | honing | een fles water | kaas | koffie |
        drie potloden | een deken | uien | zeep
    filler: eh | uhm | hm
    """
)
