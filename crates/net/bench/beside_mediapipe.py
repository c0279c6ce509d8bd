"""Joints beside MediaPipe's own: beside_mediapipe.py FIND_HANDS NET CLIP...

FIND_HANDS is the built example of this crate. Errors are in percent of the hand's length: wrist to tip of the middle finger along
its joints, the median over the clip. Needs the package mediapipe, and ffmpeg.
"""

import json
import pathlib
import subprocess
import sys
import tempfile

import mediapipe
import numpy

HANDS = 2


def frames(clip, folder):
    probe = subprocess.run(
        ["ffprobe", "-v", "error", "-select_streams", "v", "-show_entries", "stream=width,height", "-of", "json", clip],
        check=True, capture_output=True,
    )
    stream = json.loads(probe.stdout)["streams"][0]
    raw = pathlib.Path(folder, "raw")
    subprocess.run(
        ["ffmpeg", "-v", "error", "-y", "-i", clip, "-fps_mode", "passthrough", "-f", "rawvideo", "-pix_fmt", "rgb24", raw],
        check=True,
    )
    width, height = stream["width"], stream["height"]
    if raw.stat().st_size % (width * height * 3):
        width, height = height, width
    return raw, numpy.memmap(raw, numpy.uint8, "r").reshape(-1, height, width, 3)


def theirs(pictures):
    height, width = pictures.shape[1:3]
    with mediapipe.solutions.hands.Hands(model_complexity=1, max_num_hands=HANDS) as hands:
        for picture in pictures:
            found = hands.process(numpy.ascontiguousarray(picture)).multi_hand_landmarks or []
            yield [numpy.array([[p.x * width, p.y * height] for p in hand.landmark]) for hand in found]


def main(find_hands, net, clips):
    for clip in clips:
        with tempfile.TemporaryDirectory() as folder:
            raw, pictures = frames(clip, folder)
            height, width = pictures.shape[1:3]
            command = [find_hands, net, str(width), str(height), "30", str(HANDS)]
            with open(raw, "rb") as source:
                lines = subprocess.run(command, stdin=source, check=True, stdout=subprocess.PIPE, text=True).stdout
            ours = {}
            for line in lines.splitlines():
                number, _, _, *points = line.split()
                ours.setdefault(int(number), []).append(numpy.array(points, float).reshape(21, 2))
            errors, lengths, missing, more = [], [], 0, 0
            for number, hands in enumerate(theirs(pictures)):
                mine = ours.get(number, [])
                missing += max(0, len(hands) - len(mine))
                more += max(0, len(mine) - len(hands))
                for hand in hands:
                    lengths.append(numpy.linalg.norm(numpy.diff(hand[[0, 9, 10, 11, 12]], axis=0), axis=1).sum())
                    if mine:
                        each = [numpy.linalg.norm(hand - m, axis=1) for m in mine]
                        errors.append(min(each, key=numpy.mean))
            count = f"{pathlib.Path(clip).stem}: {len(pictures)} pictures, {len(lengths)} hands, {missing} missing, {more} more"
            if not errors:
                print(count, flush=True)
                continue
            errors = 100 * numpy.concatenate(errors) / numpy.median(lengths)
            print(
                f"{count}; median {numpy.median(errors):.3f} %, 95th percentile {numpy.percentile(errors, 95):.3f} %, "
                f"largest {errors.max():.1f} %",
                flush=True,
            )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3:])
