"""The package beside the program: the same bytes, arrays of the shapes that are promised."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
import unittest

import numpy as np

import handcast
from common import DEMO, InFolder, done

SIZE = (360, 480)


def pictures(count):
    """The first pictures of the built-in clip, decoded by ffmpeg."""
    words = ["ffmpeg", "-v", "error", "-i", str(DEMO), "-frames:v", str(count), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(words, check=True, capture_output=True).stdout
    return np.frombuffer(raw, np.uint8).reshape(count, *SIZE, 3)


def skin(left):
    """A picture of 160 x 120, YCbCr 4:2:0: a rectangle with the hue of skin, which is no hand."""

    def plane(scale, inside, outside):
        rows = np.full((120 // scale, 160 // scale), outside, np.uint8)
        rows[30 // scale : 90 // scale, left // scale : (left + 50) // scale] = inside
        return rows.tobytes()

    return plane(1, 170, 90) + plane(2, 110, 128) + plane(2, 152, 128)


class Tracked(InFolder):
    """What is tracked of the built-in clip."""

    @classmethod
    def setUpClass(cls):
        cls.clip = handcast.track(DEMO)

    def test_arrays_have_their_shapes_and_units(self):
        clip, hand = self.clip, self.clip.right
        self.assertIsNone(clip.left)
        self.assertEqual((len(clip.hands), clip.hands[0].side, clip.rate), (1, "right", 25.0))
        shapes = {"times": (150,), "angles": (150, 29), "wrist": (150, 4, 4), "joints": (150, 25, 3), "confidence": (150,)}
        for name, shape in shapes.items():
            array = getattr(hand, name)
            self.assertEqual((array.shape, array.dtype), (shape, np.float64), name)
            self.assertTrue(np.isfinite(array).all(), name)
        self.assertEqual((hand.valid.shape, hand.valid.dtype, hand.valid.all()), ((150,), np.bool_, True))
        np.testing.assert_allclose(hand.times, np.arange(150) / 25, atol=1e-6)
        self.assertEqual((len(handcast.ANGLES), len(handcast.JOINTS)), (29, 25))
        # The fist closes in radians, and opens again.
        bend = hand.angles[:, handcast.ANGLES.index("index2_flexion")]
        self.assertTrue(bend.max() > 1.0 and bend[0] < 0.4 and np.abs(hand.angles).max() < 2.5)
        self.assertTrue(0.5 < hand.confidence.mean() <= 1.0)
        # Metres: a hand of the length that was told, before the camera, its first joint where its matrix puts the wrist.
        wrist, tip = (handcast.JOINTS.index(name) for name in ("wrist", "middle-finger-tip"))
        np.testing.assert_allclose(hand.joints[:, wrist], hand.wrist[:, :3, 3], atol=1e-9)
        length = np.linalg.norm(hand.joints[:, tip] - hand.joints[:, wrist], axis=1).max()
        self.assertTrue(0.17 < length < 0.21, length)
        self.assertTrue((hand.wrist[:, 2, 3] < -0.1).all())
        turned = hand.wrist[:, :3, :3]
        np.testing.assert_allclose(turned @ turned.transpose(0, 2, 1), np.tile(np.eye(3), (150, 1, 1)), atol=1e-12)

    def test_streams_are_those_of_the_program(self):
        done("run", DEMO, "-o", self.folder / "run", "--no-pictures")
        stream = handcast.encode(self.clip)
        self.assertEqual(stream, (self.folder / "run" / "hand.fba").read_bytes())
        (self.folder / "py.fba").write_bytes(stream)
        for ending, made in (("glb", handcast.to_glb), ("pose", handcast.to_pose_format)):
            name = self.folder / f"native.{ending}"
            done("decode", self.folder / "py.fba", "-o", name)
            back = handcast.load(name)
            mine = self.folder / f"mine.{ending}"
            mine.write_bytes(made(handcast.decode(stream)))
            np.testing.assert_array_equal(handcast.load(mine).right.angles, back.right.angles)
        self.assertEqual(handcast.to_format(handcast.decode(stream), "pose"), (self.folder / "native.pose").read_bytes())
        for aim, flag in (({"quant": 10}, "--quant"), ({"bitrate": 1.5}, "--bitrate"), ({"max_error": 2.0}, "--max-error")):
            value = next(iter(aim.values()))
            jsonl = self.folder / "poses.jsonl"
            jsonl.write_bytes(handcast.to_format(self.clip, "jsonl"))
            done("encode", jsonl, "-o", self.folder / "aim.fba", flag, value)
            self.assertEqual(handcast.encode(handcast.load(jsonl), **aim), (self.folder / "aim.fba").read_bytes(), flag)

    def test_files_have_the_tone_of_the_skin(self):
        binary = lambda glb: glb[20 + int.from_bytes(glb[12:16], "little"):]
        decoded = handcast.decode(handcast.encode(self.clip))
        self.assertEqual((self.clip.skin_tone, decoded.skin_tone), (3, 3))
        dark = handcast.Clip(decoded.hands, decoded.rate, skin_tone=8)
        (self.folder / "tone.fba").write_bytes(handcast.encode(self.clip))
        for clip, tone in ((decoded, 3), (dark, 8)):
            done("decode", self.folder / "tone.fba", "-o", self.folder / "tone.glb", "--tone", tone)
            self.assertEqual(binary(handcast.to_glb(clip)), binary((self.folder / "tone.glb").read_bytes()))
        with self.assertRaises(handcast.Error):
            handcast.Clip(decoded.hands, skin_tone=11)

    def test_decoded_poses_are_those_that_were_encoded(self):
        hand, back = self.clip.right, handcast.decode(handcast.encode(self.clip, target_rms=0.3)).right
        off = np.degrees(back.angles - hand.angles)
        moving = np.ptp(hand.angles, axis=0) > 0
        self.assertLess(np.sqrt((off[:, moving] ** 2).mean()), 0.4)
        self.assertTrue(np.abs(back.joints - hand.joints).max() < 0.01)

    def test_clips_are_made_of_arrays(self):
        hand = self.clip.right
        angles = hand.angles
        angles[:, handcast.ANGLES.index("thumb3_flexion")] = 0.25
        made = handcast.Clip([handcast.Hand("right", angles, wrist=hand.wrist, rate=25.0, like=hand)], rate=25.0)
        np.testing.assert_array_equal(made.right.angles, angles)
        np.testing.assert_allclose(made.right.wrist, hand.wrist, atol=1e-12)
        self.assertTrue(np.isnan(made.right.confidence).all() and made.right.valid.all())
        back = handcast.decode(handcast.encode(made, max_error=1.0))
        thumb = back.right.angles[:, handcast.ANGLES.index("thumb3_flexion")]
        self.assertLess(np.abs(np.degrees(thumb - 0.25)).max(), 1.0)
        both = handcast.Clip([handcast.Hand(side, angles) for side in ("left", "right")])
        self.assertEqual([hand.side for hand in both.hands], ["left", "right"])
        # Told by the times, which are whole thirtieths to the last digit alone.
        self.assertAlmostEqual(both.rate, 30.0, places=9)

    def test_the_lock_is_free_while_it_works(self):
        worker = threading.Thread(target=handcast.track, args=(DEMO,))
        ticks, worst, last = 0, 0.0, time.monotonic()
        worker.start()
        while worker.is_alive():
            time.sleep(0.001)
            now = time.monotonic()
            ticks, worst, last = ticks + 1, max(worst, now - last), now
        self.assertTrue(ticks > 50 and worst < 1.0, f"{ticks} ticks, {worst:.2f} s at worst")


class Pushed(unittest.TestCase):
    """Frames that come one by one."""

    def test_frames_give_the_poses_of_the_tracker(self):
        frames = pictures(70)
        tracker = handcast.Tracker(fps=25.0)
        early = [pose for frame in frames for pose in tracker.push(frame)]
        poses = early + tracker.finish()
        self.assertEqual(len(poses), 70)
        self.assertGreater(len(early), 50)
        clip = handcast.track(iter(frames), fps=25.0)
        np.testing.assert_array_equal(clip.right.angles, [pose.angles for pose in poses])
        np.testing.assert_array_equal(clip.right.wrist, [pose.wrist for pose in poses])
        np.testing.assert_allclose(clip.right.times, [pose.time for pose in poses])
        first = poses[0]
        self.assertEqual((first.side, first.angles.shape, first.joints.shape, first.valid), ("right", (29,), (25, 3), True))
        # A view that is not contiguous is the same picture.
        turned = handcast.track((np.flip(np.flip(frame, 1).copy(), 1) for frame in frames), fps=25.0)
        np.testing.assert_array_equal(turned.right.angles, clip.right.angles)


class Wrong(InFolder):
    """What is refused, and how."""

    def refused(self, words, call, *args, kind=handcast.Error, **more):
        with self.assertRaises(kind) as caught:
            call(*args, **more)
        for word in words:
            self.assertIn(word, str(caught.exception))

    def test_errors_say_what_and_what_was_allowed(self):
        broken = self.folder / "broken.mp4"
        broken.write_bytes(b"no video")
        self.refused(["none.mp4"], handcast.track, self.folder / "none.mp4", kind=FileNotFoundError)
        self.refused(["broken.mp4"], handcast.track, broken)
        self.refused(["hand", "left", "right"], handcast.track, DEMO, hand="both")
        self.refused(["fov", "5", "150"], handcast.track, DEMO, fov=200)
        self.refused(["height x width x 3", "2 x 3 x 4"], handcast.track, [np.zeros((2, 3, 4), np.uint8)])
        self.refused(["uint8"], handcast.Tracker().push, np.zeros((4, 4, 3)))
        self.refused([], handcast.decode, b"no stream")
        self.refused(["29"], handcast.Hand, "left", np.zeros((3, 28)))
        self.refused(["wrist[1]"], handcast.Hand, "left", np.zeros((2, 29)), wrist=np.stack([np.eye(4), 2 * np.eye(4)]))
        self.refused(["times has 2"], handcast.Hand, "left", np.zeros((3, 29)), times=np.zeros(2))
        hand = handcast.Hand("left", np.zeros((3, 29)))
        self.refused(["twice"], handcast.Clip, [hand, hand])
        self.refused(["not finite"], handcast.Clip, [handcast.Hand("left", np.full((3, 29), np.nan))])
        clip = handcast.Clip([hand])
        self.refused(["one of them"], handcast.encode, clip, quant=3, bitrate=1.0)
        self.refused(["format", "glb"], handcast.to_format, clip, "fbx")
        self.refused([], handcast.Tracker().finish)

    @unittest.skipUnless(hasattr(os, "mkfifo"), "no pipes with names")
    def test_ctrl_c_ends_a_clip_without_a_hand(self):
        pipe = self.folder / "clip.y4m"
        os.mkfifo(pipe)
        code = "import handcast, sys\ntry: handcast.track(sys.argv[1], net=None)\nexcept KeyboardInterrupt: sys.exit(7)"
        child = subprocess.Popen([sys.executable, "-c", code, str(pipe)])
        self.addCleanup(child.kill)
        count, frames = 0, 3000
        with contextlib.suppress(BrokenPipeError), open(pipe, "wb", buffering=0) as clip:
            clip.write(b"YUV4MPEG2 W160 H120 F30:1 Ip A1:1 C420jpeg\n")
            for count in range(frames):
                clip.write(b"FRAME\n" + skin(20 + count % 60 // 2 * 2))
                time.sleep(0.005)
                if count == 200:
                    child.send_signal(signal.SIGINT)
        self.assertEqual(child.wait(timeout=60), 7)
        self.assertLess(count, frames - 1)

    def test_a_clip_without_a_hand_is_refused(self):
        self.refused([], handcast.track, [np.full((120, 160, 3), 90, np.uint8)] * 60)


if __name__ == "__main__":
    unittest.main()
