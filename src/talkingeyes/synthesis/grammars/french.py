"""Sentence grammar of French; see grammar.py."""

from talkingeyes.synthesis.grammars.rules import Grammar, rules

FRENCH: Grammar = rules(
    """
    statement:
        | {who} a {did} {thing}.
        | {who} a {did} {thing} {where}.
        | {when}, {who} a {did} {thing} {where}.
        | {view} {who} a {did} {thing} {when}.
        | {who} a {did} {thing}, mais personne ne regardait.
    question:
        | est-ce que {who} a {did} {thing} {where}?
        | pourquoi {who} a {did} {thing} {when}?
    list:
        | {who} a pris {item}, {item}, {item} et {item}.
        | sur la table, il y avait {item}, {item} et {item}.
    who: le {person} | ce pauvre {person} | notre {person} | mon ami le {person} | le jeune {person} | un
        {person} du village
    person: boulanger | facteur | pilote | voisin | peintre | marin | jardinier | docteur | tailleur | chanteur
    did: vendu | perdu | trouvé | réparé | oublié | caché | nettoyé | porté | mesuré | décrit
    thing: le petit {object} | un vieux {object} | son {object} | le dernier {object} | ce grand {object}
    object: panier | tambour | miroir | piano | bateau | tapis | vélo | fauteuil | parapluie | couteau
    where: dans le {place} | près du {place} | derrière le {place} | devant le {place}
    place: port | village | jardin | marché | musée | théâtre | bois | moulin
    when: hier soir | ce matin | après la pluie | avant le dîner | lundi dernier | pendant les vacances | en
        hiver
    view: je crois que | tout le monde sait que | on m'a dit que | il est vrai que
    item: du pain | des pommes | une carte | deux bougies | du fromage | une lampe | du miel | trois crayons |
        une couverture | du savon | du café | des oignons
    filler: euh | euh
    """
)
