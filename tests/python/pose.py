"""Reads a .pose file with pose-format, prints what is in it as JSON, and writes it anew among components of the body."""
import json
import sys

import numpy as np
from pose_format import Pose
from pose_format.numpy.pose_body import NumPyPoseBody
from pose_format.pose_header import PoseHeader, PoseHeaderComponent

source, target = sys.argv[1:]
with open(source, "rb") as file:
    pose = Pose.read(file.read())
data = np.ma.filled(pose.body.data.astype(np.float64), 0.0)
print(json.dumps({
    "fps": float(pose.body.fps),
    "size": [pose.header.dimensions.width, pose.header.dimensions.height],
    "components": [[c.name, c.format, c.points, [list(l) for l in c.limbs]] for c in pose.header.components],
    "data": data.tolist(),
    "confidence": pose.body.confidence.tolist(),
}))

# As Holistic's files are: other components before and between the hands.
body = PoseHeaderComponent("POSE_LANDMARKS", ["NOSE", "LEFT_EYE", "RIGHT_EYE"], [(0, 1), (0, 2)], [(9, 8, 7)], "XYZC")
frames, people, _, axes = data.shape
extra = np.full((frames, people, 3, axes), 7.5)
header = PoseHeader(0.2, pose.header.dimensions, [body, *pose.header.components])
confidence = np.concatenate([np.ones((frames, people, 3)), pose.body.confidence], axis=2).astype(np.float32)
points = np.ma.array(np.concatenate([extra, data], axis=2).astype(np.float32))
with open(target, "wb") as file:
    Pose(header, NumPyPoseBody(pose.body.fps, points, confidence)).write(file)
