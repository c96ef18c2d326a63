"""Sentence grammar of Italian; see grammar.py."""

from talkingeyes.synthesis.grammars.rules import Grammar, rules

ITALIAN: Grammar = rules(
    """
    statement:
        | {who} ha {did} {thing}.
        | {who} era {feeling}.
        | {who} ha {did} {thing} {where}.
        | {when}, {who} ha {did} {thing} {where}.
        | {view} {who} ha {did} {thing} {when}.
        | {who} ha {did} {thing}, ma nessuno guardava.
        | {who} era {feeling} perché nessuno ha {did} {thing}.
    question:
        | perché {who} ha {did} {thing} {when}?
        | sai se {who} ha {did} {thing} {where}?
        | chi ha detto che {who} ha {did} {thing} {when}?
    list:
        | {who} ha comprato {item}, {item}, {item} e {item}.
        | sul tavolo c'erano {item}, {item} e {item}.
        | ci servono {item}, {item}, {item} e forse {item}.
    who: il {person} {kind} | il mio {person} | il nostro {person} | un {person} del paese | quel {person}
        {kind}
    kind: vecchio | giovane | tranquillo | allegro | stanco | famoso | simpatico | pigro | timido | gentile
    person: panettiere | maestro | pilota | pittore | giardiniere | pescatore | sarto | vicino | medico |
        falegname | cugino | contadino
    did: trovato | perso | venduto | dimenticato | nascosto | pulito | misurato | descritto | portato | aperto |
        riparato
    thing: il {look} {object} | un {look} {object} | il suo {object} | questo {object}
    look: piccolo | grande | vecchio | nuovo | bel | lungo | pesante | curioso
    object: cestino | tamburo | tappeto | pianoforte | coltello | lampione | bastone | libro | cappello | vaso |
        tavolo | quaderno
    where: nel {place} | dietro il {place} | vicino al {place} | davanti al {place}
    place: porto | giardino | mercato | museo | bosco | teatro | paese | faro | mulino | cortile
    when: ieri | stamattina | l'estate scorsa | prima di colazione | dopo il temporale | una settimana fa | a
        mezzanotte | in inverno
    feeling: contento | sorpreso | molto stanco | un po' preoccupato | piuttosto fiero | tranquillo | arrabbiato
        | grato
    view: credo che | tutti sanno che | qualcuno mi ha detto che | è vero che
    item: pane | mele | una mappa | due candele | calze di lana | miele | una bottiglia d'acqua | formaggio |
        caffè | tre matite | una coperta | cipolle | sapone
    filler: ehm | eh | mm
    """
)
