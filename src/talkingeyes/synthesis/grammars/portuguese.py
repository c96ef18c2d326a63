"""Sentence grammar of Portuguese; see grammar.py."""

from talkingeyes.synthesis.grammars.rules import Grammar, rules

PORTUGUESE: Grammar = rules(
    """
    statement:
        | {who} {did} {thing}.
        | {who} estava {feeling}.
        | {who} {did} {thing} {where}.
        | {when}, {who} {did} {thing} {where}.
        | {view} {who} {did} {thing} {when}.
        | {who} {did} {thing}, mas ninguém estava olhando.
        | {who} estava {feeling} porque ninguém {did} {thing}.
    question:
        | por que {who} {did} {thing} {when}?
        | você sabe se {who} {did} {thing} {where}?
        | quem disse que {who} {did} {thing} {when}?
    list:
        | {who} comprou {item}, {item}, {item} e {item}.
        | em cima da mesa havia {item}, {item} e {item}.
        | precisamos de {item}, {item}, {item} e talvez {item}.
    who: o {person} {kind} | o meu {person} | o nosso {person} | um {person} da vila | aquele {person} {kind}
    kind: velho | jovem | calmo | alegre | cansado | famoso | simpático | preguiçoso | alto | tímido
    person: padeiro | professor | piloto | pintor | jardineiro | pescador | alfaiate | vizinho | médico |
        carpinteiro | primo | fazendeiro
    did: encontrou | perdeu | vendeu | esqueceu | escondeu | limpou | mediu | descreveu | levou | abriu |
        consertou
    thing: o {object} {look} | um {object} {look} | o seu {object} | outro {object} {look}
    look: pequeno | verde | pesado | vazio | redondo | estranho | quebrado | amarelo | antigo
    object: cesto | espelho | armário | tambor | piano | tapete | relógio | barco | livro | chapéu | martelo |
        vaso
    where: no {place} | atrás do {place} | perto do {place} | a caminho do {place}
    place: porto | jardim | mercado | museu | bosque | teatro | farol | moinho | colégio | sítio
    when: ontem | hoje de manhã | no verão passado | antes do café | depois da tempestade | há uma semana | à
        meia-noite | no inverno
    feeling: contente | surpreso | muito cansado | um pouco preocupado | bastante orgulhoso | tranquilo |
        zangado | grato
    view: acho que | todo mundo sabe que | alguém me contou que | é verdade que
    item: pão | maçãs | um mapa | duas velas | meias quentes | mel | uma garrafa de água | queijo | café | três
        lápis | um cobertor | cebolas | sabão
    filler: é | ahn | hum
    """
)
