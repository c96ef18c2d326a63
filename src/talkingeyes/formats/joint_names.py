"""Joints of head and eyes by the names that programs give them: one rule for all readers and editors.

    LeftEye  mixamorig:LeftEye  J_Adj_L_FaceEye  CC_Base_L_Eye  FACIAL_L_Eye  DEF-eye.L  lEye  左目    ->  left_eye

A name is split into words; words for the rig and for bones in general are left out, and what is left must be the part
and, of an eye, its side. So LeftEye_end, eyelid.L and head_target are none.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence

from talkingeyes.core.errors import InputError

JOINTS = ("left_eye", "right_eye", "head", "neck", "jaw")
PARTS = {
    "eye": ("eye", "eyeball", "face eye", "eye ball"),
    "head": ("head", "spine 006"),  # Rigify's spine ends in neck and head
    "neck": ("neck", "neck twist", "neck lower", "neck upper", "lower neck", "upper neck", "spine 004"),
    "jaw": ("jaw", "jaw root", "jaw master", "lower jaw", "jaw lower"),
}
SIDES = {"left": ("l", "lf", "lft", "left"), "right": ("r", "rt", "rgt", "right")}
OWN_WORDS = {word for each in (*PARTS.values(), *SIDES.values()) for words in each for word in words.split()}
_OTHER_WORDS = """adj armature avatar b base bind bip biped bn bone c cc character def deform facial j jnt joint jt m
mch mid middle mixamorig model org rig rl skeleton skin smplhf valve x"""
OTHER_WORDS = frozenset(_OTHER_WORDS.split())  # of rigs, and of bones in general
GENERATED = {"def": -1, "org": 1, "mch": 2}  # of Rigify: the bone that moves the mesh first
JAPANESE = str.maketrans(
    {"左": " left ", "右": " right ", "目": " eye ", "頭": " head ", "首": " neck ", "顎": " jaw "}
)  # of MMD
KNOWN_PART = re.compile(r"(left|right|eyeball|eye|head|neck|jaw|spine)", re.IGNORECASE)
WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|[^\W\d_A-Za-z]+")


def joints_by_name(names: Sequence[str]) -> dict[str, list[int]]:
    """The indices of names that a joint can have, the likeliest first, for those of JOINTS that there are."""
    split = [_words(name) for name in names]
    first = Counter(words[0] for words in split if len(words) > 1)
    shared = {word for word, count in first.items() if count > max(2, len(names) / 2)}  # the name of a character
    found: dict[str, list[tuple[int, int, int]]] = {}
    for index, words in enumerate(split):
        joint = _joint(words[1:] if words and words[0] in shared - OWN_WORDS else words)
        if joint is not None:
            order = min((GENERATED[word] for word in words if word in GENERATED), default=0)
            found.setdefault(joint, []).append((order, len(words), index))
    return {joint: [index for *_, index in sorted(each)] for joint, each in found.items()}


def check_joints(given: Mapping[str, str]) -> Mapping[str, str]:
    """Names of joints as given by the user. Raises InputError (one line) for a joint that is none of JOINTS."""
    unknown = next((joint for joint in given if joint not in JOINTS), None)
    if unknown is not None:
        raise InputError(f"joint: should be {', '.join(f'{joint}=NAME' for joint in JOINTS)}, got {unknown}")
    return given


def parse_joints(options: Sequence[str]) -> Mapping[str, str]:
    """The options `left_eye=NAME` of a command."""
    return check_joints({joint: name for joint, _, name in (each.partition("=") for each in options)})


def list_names(names: Sequence[str], most: int = 6) -> str:
    """Some names for a message, those of eyes first."""
    shown = sorted(filter(None, names), key=lambda name: "eye" not in name.lower())
    more = f", ... ({len(shown)} in all)" if len(shown) > most else ""
    return f"{', '.join(shown[:most]) or 'none'}{more}"


def _words(name: str) -> tuple[str, ...]:
    """The words of a name without its namespace, in small letters."""
    plain = re.split(r"[:|]", name)[-1].translate(JAPANESE).replace("あご", " jaw ")
    return tuple(word.lower() for word in WORD.findall(KNOWN_PART.sub(r" \1 ", plain)))


def _joint(words: Sequence[str]) -> str | None:
    left = [word for word in words if word not in OTHER_WORDS]
    sides = [side for word in left for side, spelled in SIDES.items() if word in spelled]
    rest = [word for word in left if not any(word in spelled for spelled in SIDES.values())]
    spellings = {" ".join(rest), " ".join(word for word in rest if not word.isdigit())}
    part = next((part for part, known in PARTS.items() if not spellings.isdisjoint(known)), None)
    if part == "eye":
        return f"{sides[0]}_eye" if len(sides) == 1 else None
    return part if not sides else None
