"""Makes files of MANO's rotations with NumPy, and the joints that they stand for, by forward kinematics of its own.

First argument: landmark lines of the flat hand (21 joints, upright, the palm to the viewer), as the command has read them of
zeros. Second: the folder to write to. Writes flat.npz first, where the first argument is "-".
"""
import json
import sys

import numpy as np

rest_file, folder = sys.argv[1:]
if rest_file == "-":
    np.savez(f"{folder}/flat.npz", hand_pose=np.zeros((1, 45)), side="right")
    sys.exit()


def turn(v):
    """Rodrigues: a matrix from axis times angle."""
    angle = np.linalg.norm(v)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = v / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


with open(rest_file) as file:
    lines = [json.loads(line) for line in file]
upright = np.array(lines[1]["points"], dtype=float)
# The lines have the tips inside the fingers, as MediaPipe does; MANO's are their ends.
assert lines[0]["tips"] == "inside"
tips = np.arange(4, 21, 4)
upright[tips] = upright[tips - 1] + (upright[tips] - upright[tips - 1]) / 0.72
upright -= upright[0]
# Fingers to -x, the thumb's side to +z, the back to +y.
rest = np.stack([-upright[:, 1], -upright[:, 2], upright[:, 0]], axis=1)

frames, fps = 40, 25
t = np.arange(frames) / fps
pose = np.zeros((frames, 15, 3))
for joint in range(12):
    pose[:, joint, 2] = (0.45 if joint % 3 < 2 else 0.25) * (1 - np.cos(2.5 * t + 0.2 * joint))
pose[:, 12, 1] = 0.15 * (1 - np.cos(3 * t))
wrist = np.stack([0.3 * np.sin(t), -1.5 + 0.4 * t, 0.2 * np.cos(2 * t)], axis=1)
place = np.stack([0.05 * np.sin(t), 0.02 * t, 0.6 + 0.1 * np.cos(t)], axis=1)

# MANO's fingers among the joints: index, middle, little, ring, thumb.
first = [5, 9, 17, 13, 1]
joints = np.zeros((frames, 21, 3))
for i in range(frames):
    root = np.array([0.096, 0.006, 0.006]) + place[i]
    joints[i, 0] = root
    for finger, base in enumerate(first):
        rotation = turn(wrist[i])
        at = root + rotation @ rest[base]
        joints[i, base] = at
        for k in range(3):
            rotation = rotation @ turn(pose[i, 3 * finger + k])
            at = at + rotation @ (rest[base + k + 1] - rest[base + k])
            joints[i, base + k + 1] = at

flat = pose.reshape(frames, 45)
np.savez(f"{folder}/whole.npz", pose=np.concatenate([wrist, flat], axis=1).astype(np.float32), trans=place, side="right", fps=fps)
np.savez_compressed(f"{folder}/parts.npz", hand_pose=np.asfortranarray(flat), global_orient=wrist, transl=place.astype(np.float32), is_right=True, fps=fps)
matrices = np.array([[turn(v) for v in frame] for frame in pose])
np.savez(f"{folder}/matrices.npz", hand_pose=matrices, global_orient=np.array([turn(v) for v in wrist])[:, None], cam_t=place, right=np.ones(frames), fps=fps)
mirror = np.array([1.0, -1.0, -1.0])
np.savez(f"{folder}/left.npz", left_hand_pose=(pose * mirror).reshape(frames, 45), fps=fps)
mean = np.tile([0.1, -0.05, 0.3], 15)
np.savez(f"{folder}/mean.npz", hand_pose=flat - mean, global_orient=wrist, transl=place, flat_hand_mean=False, hands_mean=mean, side="right", fps=fps)
np.savez(f"{folder}/joints.npz", pred_keypoints_3d=joints - place[:, None], pred_cam_t_full=place, is_right=np.ones(frames), fps=fps)
np.savez(f"{folder}/objects.npz", hand_pose=np.array([{"a": 1}], dtype=object))
# x right, y up, z towards the viewer.
print(json.dumps((joints * [1, -1, -1]).tolist()))
