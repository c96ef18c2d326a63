"""Sentence grammar of Spanish; see grammar.py."""

from talkingeyes.synthesis.grammars.rules import Grammar, rules

SPANISH: Grammar = rules(
    """
    statement:
        | {who} {did} {thing}.
        | {who} estaba {feeling}.
        | {who} {did} {thing} {where}.
        | {when}, {who} {did} {thing} {where}.
        | {view} {who} {did} {thing} {when}.
        | {who} {did} {thing}, pero nadie estaba mirando.
        | {who} estaba {feeling} porque nadie {did} {thing}.
    question:
        | ¿por qué {who} {did} {thing} {when}?
        | ¿sabes si {who} {did} {thing} {where}?
        | ¿quién dijo que {who} {did} {thing} {when}?
    list:
        | {who} compró {item}, {item}, {item} y {item}.
        | sobre la mesa había {item}, {item} y {item}.
        | necesitamos {item}, {item}, {item} y quizás {item}.
    who: el {person} {kind} | mi {person} | nuestro {person} | un {person} del pueblo | aquel {person} {kind}
    kind: viejo | joven | tranquilo | alegre | cansado | famoso | simpático | perezoso | alto | tímido
    person: panadero | maestro | piloto | pintor | jardinero | pescador | sastre | vecino | médico | carpintero
        | primo | granjero
    did: encontró | perdió | vendió | olvidó | escondió | limpió | midió | describió | llevó | abrió | arregló
    thing: el {object} {look} | un {object} {look} | su {object} | otro {object} {look}
    look: pequeño | verde | pesado | vacío | redondo | extraño | roto | amarillo | antiguo
    object: cesto | espejo | armario | paraguas | tambor | piano | sillón | cuchillo | farol | reloj | barco |
        libro
    where: en el {place} | detrás del {place} | cerca del {place} | camino del {place}
    place: puerto | jardín | mercado | museo | bosque | teatro | pueblo | faro | molino | colegio
    when: ayer | esta mañana | el verano pasado | antes del desayuno | después de la tormenta | hace una semana
        | a medianoche | en invierno
    feeling: contento | sorprendido | muy cansado | un poco preocupado | bastante orgulloso | tranquilo |
        enfadado | agradecido
    view: creo que | todo el mundo sabe que | alguien me contó que | es verdad que
    item: pan | manzanas | un mapa | dos velas | calcetines | miel | una botella de agua | queso | café | tres
        lápices | una manta | cebollas | jabón
    filler: eh | em | este
    """
)
