"""Names of face shapes as programs spell them: one rule for all readers and editors.

    shape_names(["Face_eyeBlink_L", "Face_JAWOPEN", "Face_wink"])    ->  ("eyeBlinkLeft", "jawOpen", "wink")

A name is known if it is one of STANDARD_NAMES apart from capitals, separators and the form of its side (`_L`, `.l`,
`Left`, `_left`, `L_` in front). Before it may stand a number (`01_`), what names a part of the file (`blendShapes.`,
`head|`, `rig:`) or a prefix that the shapes of the file share (`Face_`, `CTRL_expressions_`). A prefix is shared where
more names are known after it than after any other or none: a shape that corrects two others has the names of both
(`jawOpen_mouthClose`), and is none of them. Eyes of VRoid, VRM, Unified Expressions, Ready Player Me, Character Creator
and MMD have ARKit's names, or `eyesClosed` where one shape shuts both.
"""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.formats import arkit
from talkingeyes.head.eyelid.blendshapes import LID_SHAPES

# Shapes of eyes that ARKit lacks, with ARKit's of the same meaning: Audio2Face's, whose directions are the subject's,
# and one for both lids.
EYE_EQUIVALENTS = {
    "eyesLookLeft": ("eyeLookOutLeft", "eyeLookInRight"),
    "eyesLookRight": ("eyeLookInLeft", "eyeLookOutRight"),
    "eyesLookUp": ("eyeLookUpLeft", "eyeLookUpRight"),
    "eyesLookDown": ("eyeLookDownLeft", "eyeLookDownRight"),
    **{
        f"{theirs}{side[0]}": (f"{ours}{side}",)
        for theirs, ours in (("eyesClose", "eyeBlink"), ("eyesUpperLidRaiser", "eyeWide"), ("squint", "eyeSquint"))
        for side in ("Left", "Right")
    },
    "eyesClosed": ("eyeBlinkLeft", "eyeBlinkRight"),
}
STANDARD_NAMES = (*arkit.NAMES, *arkit.ANGLES, *EYE_EQUIVALENTS, *LID_SHAPES)
CLOSED = ("eyeclose", "eyeclosed", "blink")  # Fcl_EYE_Close_L of VRoid, EyeClosedLeft of Unified Expressions, Blink_L
BOTH_CLOSED = ("eyeclose", "eyeclosed", "eyesclose", "eyesclosed", "eyeblink", "eyesblink", "blink", "まばたき")
WINKS = {"ウィンク": "Left", "ウィンク2": "Left", "ウィンク右": "Right", "ウィンク2右": "Right"}  # of MMD
LOOKS = {("l", "l"): "Out", ("l", "r"): "In", ("r", "l"): "In", ("r", "r"): "Out"}  # Eye_L_Look_R of Character Creator

SEPARATOR = re.compile(r"[\W_]+")
SIDE_LAST = re.compile(r"(?<=.)(left|right|l|r)$")
SIDE_FIRST = re.compile(r"^(left|right|l|r)(.+)$")
START = re.compile(  # of a word
    r"(?<=[\W_])(?=[^\W_])|(?<=[^A-Za-z0-9])(?=[A-Za-z0-9])|(?<=[a-z0-9])(?=[A-Z])|(?<=[0-9])(?=[a-z])"
)
PART_ENDS = (".", ":", "|", "/")  # what names a part of a file ends in one of these


def shape_names(names: Sequence[str]) -> tuple[str, ...]:
    """The standard name of each shape of a file; without one, its own name (without the prefix of the file)."""
    known = [_known_after(name) for name in names]
    count = Counter(prefix for found in known for prefix in found)
    shared = max(count, key=lambda prefix: (count[prefix], -len(prefix)), default="")
    return tuple(_standard(name, found, shared) for name, found in zip(names, known, strict=True))


def arkit_shapes(shapes: Mapping[str, Float[ndarray, " T"]]) -> dict[str, Float[ndarray, " T"]]:
    """Shapes by standard name, with ARKit's for those of EYE_EQUIVALENTS; where a file has both, the greater."""
    found = dict(shapes)
    for theirs, ours in EYE_EQUIVALENTS.items():
        for name in ours if theirs in shapes else ():
            found[name] = np.fmax(found[name], shapes[theirs]) if name in found else shapes[theirs]
    return found


def _standard(name: str, found: dict[str, str], shared: str) -> str:
    """The name of a shape: of those that it has after prefixes that may be, the one after the shortest."""
    accepted = (
        prefix
        for prefix in found
        if prefix == shared or prefix.endswith(PART_ENDS) or not any(map(str.isalpha, prefix))
    )
    prefix = min(accepted, key=len, default=None)
    return name.strip().removeprefix(shared) if prefix is None else found[prefix]


def _known_after(name: str) -> dict[str, str]:
    """Prefixes of a name, the empty one among them, after which it is known, with the standard name."""
    plain = name.strip()
    starts = (0, *(match.start() for match in START.finditer(plain)))
    found = {plain[:start]: _STANDARD.get(_letters(plain[start:])) for start in starts}
    return {prefix: standard for prefix, standard in found.items() if standard is not None}


def _letters(name: str) -> str:
    """The name in small letters, without separators, its side in full and last."""
    plain = SEPARATOR.sub("", unicodedata.normalize("NFKC", name).lower())
    if plain in _STANDARD:
        return plain
    last = SIDE_LAST.sub(lambda side: _side(side[1]), plain)
    return last if last in _STANDARD else SIDE_FIRST.sub(lambda match: match[2] + _side(match[1]), plain)


def _side(written: str) -> str:
    return "left" if written.startswith("l") else "right"


# Names by small letters; those of one letter for a side also in full.
_STANDARD: dict[str, str] = {}
_STANDARD |= {SIDE_LAST.sub(lambda side: _side(side[1]), each.lower()): each for each in EYE_EQUIVALENTS}
_STANDARD |= {each.lower(): each for each in STANDARD_NAMES}
_STANDARD |= {f"{name}{side.lower()}": f"eyeBlink{side}" for name in CLOSED for side in ("Left", "Right")}
_STANDARD |= dict.fromkeys(BOTH_CLOSED, "eyesClosed") | {name: f"eyeBlink{side}" for name, side in WINKS.items()}
for eye, side in (("l", "Left"), ("r", "Right")):
    _STANDARD |= {f"eye{eye}look{to}": f"eyeLook{LOOKS[eye, to]}{side}" for to in "lr"}
    _STANDARD |= {f"eye{eye}look{to.lower()}": f"eyeLook{to}{side}" for to in ("Up", "Down")}
