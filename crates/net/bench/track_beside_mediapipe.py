"""Processor time of `handcast track` beside MediaPipe's: track_beside_mediapipe.py HANDCAST NET CLIP...

A picture's share, in milliseconds, of user and system time: of the whole command, and of a loop of OpenCV's reader and
`solutions.hands` from its eleventh picture on (before it are Python's and the networks' start). MediaPipe for two hands at most,
its default and what `track` does, where it goes on looking for the second, and for one; the larger networks. Each three times in
turns, the least is told. Needs the packages mediapipe and opencv-python-headless.
"""

import os
import pathlib
import subprocess
import sys
import tempfile

TIMES = 3
START = 10


def processor(who):
    times = os.times()
    return times.user + times.system if who == "self" else times.children_user + times.children_system


def loop(clip, hands):
    """Seconds for a picture, and pictures in all."""
    import cv2
    import mediapipe

    reader = cv2.VideoCapture(clip)
    pictures, begun = 0, 0.0
    with mediapipe.solutions.hands.Hands(model_complexity=1, max_num_hands=hands) as finder:
        while True:
            if pictures == START:
                begun = processor("self")
            there, picture = reader.read()
            if not there:
                break
            finder.process(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
            pictures += 1
        return (processor("self") - begun) / (pictures - START), pictures


def alone(clip, hands):
    """The same in a process of its own."""
    command = [sys.executable, __file__, "--loop", clip, str(hands)]
    out = subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True).stdout
    seconds, pictures = out.split()
    return float(seconds), int(pictures)


def track(program, clip, network, pictures):
    with tempfile.TemporaryDirectory() as folder:
        before = processor("children")
        command = [program, "track", "-q", clip, "-o", str(pathlib.Path(folder, "poses.jsonl")), *network]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return (processor("children") - before) / pictures


def main(program, net, clips):
    for clip in clips:
        least = {}

        def take(name, seconds):
            least[name] = min(seconds, least.get(name, seconds))

        for _ in range(TIMES):
            for hands in [2, 1]:
                seconds, pictures = alone(clip, hands)
                take(f"MediaPipe, {hands} at most", seconds)
            take("track --no-net", track(program, clip, ["--no-net"], pictures))
            take("track --net", track(program, clip, ["--net", net], pictures))
        print(f"{pathlib.Path(clip).stem}, {pictures} pictures")
        two, one = least["MediaPipe, 2 at most"], least["MediaPipe, 1 at most"]
        for name, seconds in least.items():
            print(f"  {name:21} {1000 * seconds:5.1f} ms  {seconds / two:.2f} of two hands', {seconds / one:.2f} of one's", flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "--loop":
        print(*loop(sys.argv[2], int(sys.argv[3])))
    else:
        main(sys.argv[1], sys.argv[2], sys.argv[3:])
