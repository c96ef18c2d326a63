"""Sentence grammar of German; see grammar.py."""

from talkingeyes.synthesis.grammars.rules import Grammar, rules

GERMAN: Grammar = rules(
    """
    statement:
        | {who} hat {thing} {did}.
        | {who} war {feeling}.
        | {who} hat {where} {thing} {did}.
        | {when} hat {who} {where} {thing} {did}.
        | {view} {who} {when} {thing} {did} hat.
        | {who} hat {thing} {did}, aber niemand hat zugesehen.
        | {who} war {feeling}, denn {when} hat niemand {thing} {did}.
    question:
        | hat {who} {where} {thing} {did}?
        | warum hat {who} {when} {thing} {did}?
        | weißt du, ob {who} {when} {thing} {did} hat?
    list:
        | {who} hat {item}, {item}, {item} und {item} eingepackt.
        | auf dem Tisch lagen {item}, {item} und {item}.
        | wir brauchen noch {item}, {item}, {item} und vielleicht {item}.
    who: der {kind} {person} | mein {person} | unser {person} | ein {person} aus dem Dorf | der {person} von
        nebenan
    kind: alte | junge | stille | fröhliche | müde | berühmte | faule | freundliche | große | kluge
    person: Bäcker | Lehrer | Pilot | Maler | Gärtner | Fischer | Schneider | Sänger | Nachbar | Bauer | Förster
        | Zimmermann
    did: gefunden | verloren | verkauft | vergessen | versteckt | geputzt | gemessen | beschrieben | getragen |
        geöffnet
    thing: den {look} {object} | einen {look} {object} | jeden {object} | seinen {object}
    look: alten | kleinen | grünen | schweren | leeren | runden | seltsamen | staubigen | silbernen
    object: Korb | Koffer | Spiegel | Schrank | Teppich | Regenschirm | Schlüssel | Stuhl | Kessel | Kompass |
        Brief | Hammer
    where: im {place} | hinter dem {place} | neben dem {place} | auf dem Weg zum {place}
    place: Hafen | Garten | Bahnhof | Markt | Museum | Wald | Theater | Rathaus | Leuchtturm | Dorf
    when: gestern | heute Morgen | letzten Sommer | vor dem Frühstück | nach dem Sturm | vor einer Woche | um
        Mitternacht | im Winter | in den Ferien
    feeling: glücklich | überrascht | sehr hungrig | ein wenig besorgt | ziemlich stolz | ganz ruhig | wütend |
        müde | dankbar
    view: ich glaube, dass | jeder weiß, dass | jemand hat erzählt, dass | es stimmt, dass
    item: Brot | Äpfel | eine Karte | zwei Kerzen | warme Socken | Honig | eine Flasche Wasser | Käse | Kaffee |
        drei Bleistifte | eine Decke | Zwiebeln | Seife
    filler: äh | ähm | hm
    """
)
