"""Imports GLB files with Blender's importer as it is set by default, and says how the bones lie.

Usage: blender.py FILE...; prints a line of JSON for each: the bones with one child, each with the degrees between it and the way
to the child, at rest and in the pose of every tenth frame; the frames of the scene.
"""

import json
import math
import sys

import bpy


def degrees(a, b):
    return math.degrees(a.angle(b))


for path in sys.argv[1:]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=path)
    armatures = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
    rest, posed = {}, {}
    first, last = (int(v) for v in bpy.data.actions[0].frame_range) if bpy.data.actions else (0, 0)
    for armature in armatures:
        single = [bone for bone in armature.data.bones if len(bone.children) == 1]
        for bone in single:
            child = bone.children[0]
            rest[bone.name] = degrees(bone.tail_local - bone.head_local, child.head_local - bone.head_local)
        for frame in range(first, last + 1, 10):
            bpy.context.scene.frame_set(frame)
            for bone in single:
                here, child = armature.pose.bones[bone.name], armature.pose.bones[bone.children[0].name]
                off = degrees(here.tail - here.head, child.head - here.head)
                posed[bone.name] = max(posed.get(bone.name, 0.0), off)
    report = {"rest": rest, "posed": posed, "frames": [first, last], "armatures": len(armatures)}
    print("REPORT " + json.dumps(report), flush=True)
