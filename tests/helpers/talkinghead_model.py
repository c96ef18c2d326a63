"""The open head as an avatar of TalkingHead: the GLB of our writer under an armature with a Mixamo skeleton."""

from __future__ import annotations

from pathlib import Path

from vrm_model import still_head, write_content

# Parent and offset in metres of each bone but those of the head.
BONES: dict[str, tuple[str, tuple[float, float, float]]] = {
    "Hips": ("Armature", (0.0, 1.0, 0.0)),
    "Spine": ("Hips", (0.0, 0.1, 0.0)),
    "Spine1": ("Spine", (0.0, 0.1, 0.0)),
    "Spine2": ("Spine1", (0.0, 0.15, 0.0)),
    "Neck": ("Spine2", (0.0, 0.15, 0.0)),
    **{
        f"{side}{bone}": (f"{side}{parent}" if parent[0] != "-" else parent[1:], (sign * x, y, z))
        for side, sign in (("Left", 1.0), ("Right", -1.0))
        for bone, parent, x, y, z in (
            ("Shoulder", "-Spine2", 0.05, 0.1, 0.0),
            ("Arm", "Shoulder", 0.12, 0.0, 0.0),
            ("ForeArm", "Arm", 0.27, 0.0, 0.0),
            ("Hand", "ForeArm", 0.25, 0.0, 0.0),
            ("UpLeg", "-Hips", 0.09, -0.05, 0.0),
            ("Leg", "UpLeg", 0.0, -0.42, 0.0),
            ("Foot", "Leg", 0.0, -0.40, 0.0),
            ("ToeBase", "Foot", 0.0, -0.05, 0.1),
            *(
                (f"Hand{finger}{n}", f"Hand{finger}{n - 1}" if n > 1 else "Hand", 0.03, 0.0, 0.0)
                for finger in ("Thumb", "Index", "Middle", "Ring", "Pinky")
                for n in (1, 2, 3)
            ),
        )
    },
}


def talkinghead_model(path: Path) -> Path:
    """Write the avatar; its bone `Head` is the head's joint at the neck."""
    read = still_head(path)
    content = read.content
    nodes = content["nodes"]
    names = [node["name"] for node in nodes]
    mesh, root = names.index("head"), names.index("root")
    for ours, theirs in (("neck", "Head"), ("left_eye", "LeftEye"), ("right_eye", "RightEye"), ("head", "Wolf3D_Head")):
        nodes[names.index(ours)]["name"] = theirs
    places = {"Armature": len(nodes)} | {name: len(nodes) + 1 + index for index, name in enumerate(BONES)}
    nodes.append({"name": "Armature", "children": [mesh]})
    nodes += [{"name": name, "translation": list(offset)} for name, (_, offset) in BONES.items()]
    for name, (parent, _) in BONES.items():
        nodes[places[parent]].setdefault("children", []).append(places[name])
    nodes[places["Neck"]].setdefault("children", []).append(root)
    nodes[root]["translation"] = [0.0, 0.0, 0.0]
    # TalkingHead lets the lowest point of an avatar down to the floor, which is to be that of a body, not the neck.
    nodes[places["Armature"]]["children"].append(len(nodes))
    shape = content["meshes"][nodes[mesh]["mesh"]]["primitives"][0]
    still = {"attributes": {"POSITION": shape["attributes"]["POSITION"]}, "indices": shape["indices"]}
    nodes.append({"name": "Floor", "mesh": len(content["meshes"]), "scale": [0.001, 0.001, 0.001]})
    content["meshes"].append({"primitives": [still]})
    content["scenes"][0]["nodes"] = [places["Armature"]]
    return write_content(path, content, read.binary)
