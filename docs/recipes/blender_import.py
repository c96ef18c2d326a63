"""Blender: the head of `talkingeyes export -f glb` with its motion, sound and camera, as a .blend or a picture.

    blender --background --python blender_import.py -- HEAD.glb OUT.blend [--sound SPEECH.wav] [--still OUT.png SECOND]

or, with the package bpy in Python: python blender_import.py HEAD.glb OUT.blend. What Blender's importer makes of the
file: a mesh with shape keys under ARKit's names, an armature with the joints, an action for each; the scene gets the
motion's frame rate and length, the sound in the sequencer, a camera and a light.
"""

import argparse
import json
import math
import struct
import sys
from pathlib import Path

import bpy


def read_rate(path: Path) -> tuple[float, int]:
    """Frames a second and frames of the animation, from the times that the file holds."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    times = document["accessors"][document["animations"][0]["samplers"][0]["input"]]
    frames = times["count"]
    return (frames - 1) / times["max"][0] if frames > 1 else 25.0, frames


def import_head(path: Path) -> None:
    """An empty scene with the head, at its own frame rate."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    rate, frames = read_rate(path)
    scene = bpy.context.scene
    scene.render.fps = math.ceil(rate)
    scene.render.fps_base = math.ceil(rate) / rate
    scene.frame_start, scene.frame_end = 0, frames - 1
    bpy.ops.import_scene.gltf(filepath=str(path))  # it places keys by the rate of the scene
    mesh = next(each for each in bpy.data.objects if each.type == "MESH" and each.data.shape_keys)
    for key in mesh.data.shape_keys.key_blocks:
        key.slider_min, key.slider_max = -10.0, 10.0  # Blender cuts at 0 and 1, but lids go beyond: 1 mm in a blink
    for material in mesh.data.materials:
        colour_by_vertex(material, mesh.data.color_attributes[0].name)


def colour_by_vertex(material: bpy.types.Material, layer: str) -> None:
    """The head's colours are those of its vertices."""
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    colour = nodes.new("ShaderNodeVertexColor")
    colour.layer_name = layer
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    links.new(colour.outputs["Color"], shader.inputs["Base Color"])


def add_sound(path: Path) -> None:
    """The speech, from the first frame."""
    scene = bpy.context.scene
    editor = scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences  # renamed in Blender 4.4
    strips.new_sound("speech", str(path.resolve()), channel=1, frame_start=scene.frame_start)


def add_camera_and_light() -> None:
    """The face from the front: the glTF importer turns y up into z up, so the face looks along -y."""
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location, camera.rotation_euler = (0.0, -1.0, 0.04), (math.pi / 2, 0.0, 0.0)
    camera.data.lens = 85
    light = bpy.data.objects.new("light", bpy.data.lights.new("light", "AREA"))
    light.location, light.rotation_euler = (0.3, -1.0, 0.5), (math.radians(65), 0.0, math.radians(17))
    light.data.energy, light.data.size = 25.0, 0.6
    for each in (camera, light):
        scene.collection.objects.link(each)
    scene.camera = camera
    world = bpy.data.worlds.new("world")
    world.color = (0.35, 0.35, 0.35)
    scene.world = world


def render_still(path: Path, second: float) -> None:
    """A picture of one moment, by Cycles on the CPU."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples = "CPU", 8
    scene.cycles.use_denoising = False
    scene.render.resolution_x = scene.render.resolution_y = 256
    scene.frame_set(round(second * scene.render.fps / scene.render.fps_base))
    scene.render.filepath = str(path.resolve())
    bpy.ops.render.render(write_still=True)


def main(words: list[str]) -> None:
    """Import, add what is wanted, save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("head", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--sound", type=Path)
    parser.add_argument("--still", nargs=2, metavar=("PNG", "SECOND"))
    given = parser.parse_args(words)
    import_head(given.head)
    if given.sound:
        add_sound(given.sound)
    add_camera_and_light()
    if given.still:
        render_still(Path(given.still[0]), float(given.still[1]))
    bpy.ops.wm.save_as_mainfile(filepath=str(given.out.resolve()))
    print(f"{given.out}: {bpy.context.scene.frame_end + 1} frames")


if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
