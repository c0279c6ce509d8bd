"""The package beside the program: the same bytes, arrays of the shapes that are promised."""

import contextlib
import copy
import multiprocessing
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
import unittest
import warnings

import numpy as np

import handcast
from common import DEMO, ROOT, InFolder, done

SIZE = (360, 480)


def pictures(count):
    """The first pictures of the built-in clip, decoded by ffmpeg."""
    words = ["ffmpeg", "-v", "error", "-i", str(DEMO), "-frames:v", str(count), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(words, check=True, capture_output=True).stdout
    return np.frombuffer(raw, np.uint8).reshape(count, *SIZE, 3)


def track_hand(path):
    """What a worker does."""
    return handcast.track(path).right


def skin(left):
    """A picture of 160 x 120, YCbCr 4:2:0: a rectangle with the hue of skin, which is no hand."""

    def plane(scale, inside, outside):
        rows = np.full((120 // scale, 160 // scale), outside, np.uint8)
        rows[30 // scale : 90 // scale, left // scale : (left + 50) // scale] = inside
        return rows.tobytes()

    return plane(1, 170, 90) + plane(2, 110, 128) + plane(2, 152, 128)


def binary(glb):
    """What a GLB file has behind its JSON."""
    return glb[20 + int.from_bytes(glb[12:16], "little") :]


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
        for option, flags in (({"live": True}, ["--live"]), ({"sizes": False, "intra": 2.0}, ["--no-sizes", "--intra", 2])):
            done("encode", jsonl, "-o", self.folder / "other.fba", *flags)
            made = handcast.encode(handcast.load(jsonl), **option)
            self.assertEqual(made, (self.folder / "other.fba").read_bytes(), flags)

    def test_files_are_the_same_where_skins_are_kept(self):
        decoded = handcast.decode(handcast.encode(self.clip))
        first = handcast.to_glb(decoded)
        # Another process has kept none.
        (self.folder / "kept.fba").write_bytes(handcast.encode(self.clip))
        done("decode", self.folder / "kept.fba", "-o", self.folder / "kept.glb")
        self.assertEqual(binary(first), binary((self.folder / "kept.glb").read_bytes()))
        handcast.to_glb(handcast.Clip(decoded.hands, decoded.rate, skin_tone=9))
        self.assertEqual(handcast.to_glb(decoded), first)
        self.assertEqual(handcast.to_format(decoded, "glb"), first)
        self.assertIn(b'"asset"', handcast.to_format(decoded, "gltf"))

    def test_files_have_the_tone_of_the_skin(self):
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

    def test_clips_are_pickled_copied_and_compared(self):
        clip = self.clip
        for other in (pickle.loads(pickle.dumps(clip)), copy.deepcopy(clip), copy.copy(clip)):
            self.assertEqual(other, clip)
            self.assertEqual(handcast.to_format(other, "jsonl"), handcast.to_format(clip, "jsonl"))
            self.assertEqual(handcast.encode(other), handcast.encode(clip))
        hand = pickle.loads(pickle.dumps(clip.right))
        self.assertEqual((hand, hand.sizes), (clip.right, clip.right.sizes))
        self.assertNotEqual(handcast.Clip([hand], 25.0), clip)
        self.assertNotEqual(hand, handcast.Hand("right", hand.angles))
        valid = np.arange(5) % 2 == 0
        lost = handcast.Hand("left", np.zeros((5, 29)), valid=valid, confidence=[0, 0.5, np.nan, 1, 1])
        back = pickle.loads(pickle.dumps(lost))
        np.testing.assert_array_equal(back.valid, valid)
        np.testing.assert_array_equal(back.confidence, lost.confidence)
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            self.assertEqual(pool.map(track_hand, [DEMO]), [clip.right])

    @unittest.skipUnless("fork" in multiprocessing.get_all_start_methods(), "no fork here")
    def test_a_process_that_was_forked_has_threads_of_its_own(self):
        stream = handcast.encode(self.clip)
        with warnings.catch_warnings():
            # Python 3.12 warns of forks beside threads.
            warnings.simplefilter("ignore", DeprecationWarning)
            with multiprocessing.get_context("fork").Pool(2) as pool:
                made = pool.map_async(handcast.encode, [self.clip] * 4).get(timeout=120)
                hands = pool.map_async(track_hand, [DEMO] * 2).get(timeout=120)
        self.assertEqual(made, [stream] * 4)
        self.assertEqual(hands, [self.clip.right] * 2)

    def test_streams_are_coded_anew_from_their_baps(self):
        vectors = ROOT / "fixtures" / "conformance"
        names = [path for path in sorted(vectors.rglob("*")) if path.suffix in (".fba", ".bap")]
        same = 0
        for path in names:
            out = self.folder / "anew.fba"
            try:
                clip = handcast.load(path)
                stream = handcast.encode(clip)
            except handcast.Error:
                continue
            done("encode", path, "-o", out, "-q")
            self.assertEqual(stream, out.read_bytes(), path)
            self.assertEqual(handcast.encode(pickle.loads(pickle.dumps(clip))), stream, path)
            same += 1
        self.assertGreater(same, 3, names)

    def test_streams_come_in_any_buffer(self):
        stream = handcast.encode(self.clip)
        clip = handcast.decode(stream)
        for buffer in (bytearray(stream), memoryview(stream), np.frombuffer(stream, np.uint8)):
            self.assertEqual(handcast.decode(buffer), clip)
        with self.assertRaisesRegex(TypeError, "stream"):
            handcast.decode("text")

    def test_damage_is_told_or_concealed(self):
        stream = handcast.encode(self.clip, resync=True, intra=1.0)
        for cut in (stream[: len(stream) // 2], stream[:-1]):
            with self.assertRaises(handcast.Error):
                handcast.decode(cut)
            with self.assertWarnsRegex(handcast.HandcastWarning, "held"):
                hand = handcast.decode(cut, conceal=True).right
            self.assertTrue(0 < hand.valid.sum() <= len(hand.times) <= 150)

    def test_help_tells_shapes_and_units(self):
        for thing, words in (
            (handcast.encode, ["kbit/s", "degrees", "0 to 31"]),
            (handcast.decode, ["bytes"]),
            (handcast.load, ["OSError"]),
            (handcast.Hand, ["T×29", "T×4×4"]),
            (handcast.Hand.angles, ["T×29", "radians"]),
            (handcast.Hand.joints, ["T×25×3", "metres"]),
            (handcast.Pose.wrist, ["4×4"]),
            (handcast.Clip.skin_tone, ["1 (lightest) to 10"]),
        ):
            for word in words:
                self.assertIn(word, thing.__doc__)
        for kind in (handcast.Hand, handcast.Pose, handcast.Clip, handcast.Tracker):
            told = [name for name, what in vars(kind).items() if not name.startswith("_") and not what.__doc__]
            self.assertEqual(told, [], kind)

    def test_the_lock_is_free_while_it_works(self):
        worker = threading.Thread(target=handcast.track, args=(DEMO,))
        ticks, worst, last = 0, 0.0, time.monotonic()
        worker.start()
        while worker.is_alive():
            time.sleep(0.001)
            now = time.monotonic()
            ticks, worst, last = ticks + 1, max(worst, now - last), now
        self.assertTrue(ticks > 50 and worst < 1.0, f"{ticks} ticks, {worst:.2f} s at worst")


class Warned(InFolder):
    """What the command says on standard error."""

    def said(self, call, *args, **more):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            call(*args, **more)
        self.assertTrue(all(one.category is handcast.HandcastWarning and one.filename == __file__ for one in caught))
        return [str(one.message) for one in caught]

    def test_what_a_stream_lacks_is_said(self):
        angles = np.zeros((30, 29))
        angles[:, 4] = np.linspace(0, 1, 30)
        still = np.tile(np.eye(4), (30, 1, 1))
        far = still.copy()
        far[:, 2, 3] = -4.0
        clip = lambda rate=30.0, **more: handcast.Clip([handcast.Hand("right", angles, **more)], rate)
        self.assertEqual(self.said(handcast.encode, clip(wrist=still)), [])
        for made, word in (
            (clip(wrist=far), "in 30 poses the wrist is more than 3.46 m"),
            (clip(valid=np.arange(30) != 9), "1 pose in a gap is interpolated"),
            (clip(valid=np.arange(30) % 20 < 8), "14 poses are of a lost hand"),
            (clip(24.0), "interpolated at 24.00 frames/s"),
        ):
            (told,) = self.said(handcast.encode, made)
            self.assertIn(word, told)
        (told,) = self.said(handcast.encode, clip(), bitrate=0.01)
        self.assertIn("could not be held", told)

    def test_what_is_not_of_one_stream_is_said(self):
        stream = handcast.encode(handcast.load(ROOT / "fixtures" / "demo.poses.jsonl"), resync=True, intra=1.0)
        self.assertEqual(self.said(handcast.decode, stream), [])
        for bytes, word in (
            (stream + b"more", "4 bytes behind the end code"),
            (stream + stream, "2 streams"),
            (stream[20:], "begins in the middle of a stream"),
        ):
            (told,) = self.said(handcast.decode, bytes)
            self.assertIn(word, told)


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
        # With sizes and tone as well.
        self.assertEqual(tracker.clip(poses), clip)
        self.assertEqual(tracker.skin_tone, clip.skin_tone)
        self.assertEqual(handcast.encode(tracker.clip(poses)), handcast.encode(clip))
        self.assertEqual(poses[-1].sizes, clip.right.sizes)
        hand = handcast.Hand("right", [pose.angles for pose in poses], like=poses[-1])
        self.assertEqual(hand.sizes, clip.right.sizes)
        self.assertEqual(pickle.loads(pickle.dumps(first)), first)
        # A view that is not contiguous is the same picture.
        turned = handcast.track((np.flip(np.flip(frame, 1).copy(), 1) for frame in frames), fps=25.0)
        np.testing.assert_array_equal(turned.right.angles, clip.right.angles)


class Live(unittest.TestCase):
    """Both ends of a socket."""

    def test_poses_go_through_a_socket(self):
        clip = handcast.load(ROOT / "fixtures" / "demo.poses.jsonl")
        hand = clip.right
        one = lambda k: handcast.Hand("right", hand.angles[k : k + 1], wrist=hand.wrist[k : k + 1], times=hand.times[k : k + 1], like=hand)
        here, there = socket.socketpair()
        self.addCleanup(there.close)

        def send():
            encoder = handcast.LiveEncoder(rate=clip.rate)
            with here:
                for k in range(len(hand)):
                    here.sendall(encoder.push([one(k)], skin_tone=4))
                    self.assertEqual(encoder.hands, ["right"])
                here.sendall(encoder.finish())

        sender = threading.Thread(target=send)
        sender.start()
        decoder, poses = handcast.LiveDecoder(), []
        while data := there.recv(37):
            poses += decoder.push(data)
        poses += decoder.finish()
        sender.join()
        self.assertEqual(len(poses), len(hand))
        self.assertEqual((decoder.rate, decoder.skin_tone), (clip.rate, 4))
        np.testing.assert_allclose([pose.time for pose in poses], hand.times - hand.times[0], atol=1e-3)
        off = np.degrees(np.abs([pose.angles for pose in poses] - hand.angles))
        self.assertLess(np.sqrt((off**2).mean()), 0.6)
        self.assertAlmostEqual(poses[-1].sizes["hand_length"], hand.sizes["hand_length"], places=3)

    def test_planes_are_decoded_when_they_come(self):
        encoder, decoder = handcast.LiveEncoder(bitrate=4.0, intra=1.0), handcast.LiveDecoder()
        angles, seen = np.zeros((90, 29)), 0
        angles[:, 6] = 0.5 - 0.5 * np.cos(np.arange(90) / 9)
        for k in range(90):
            plane = encoder.push([handcast.Hand("left", angles[k : k + 1], times=[k / 30])], k / 30)
            poses = decoder.push(plane, whole=True)
            if poses:
                seen += 1
                self.assertLess(abs(poses[-1].angles[6] - angles[k, 6]), 0.1)
        self.assertGreater(seen, 60)
        # One that joins late begins at the next I plane.
        encoder.request_intra()
        late, found = handcast.LiveDecoder(), []
        for k in range(90, 150):
            found += late.push(encoder.push([handcast.Hand("left", angles[k - 90 : k - 89], times=[k / 30])]), whole=True)
        self.assertGreater(len(found), 20)
        # Without a hand nothing is sent, and lost planes are held.
        self.assertEqual(handcast.LiveEncoder().push([]), b"")
        self.assertEqual(handcast.LiveEncoder().finish(), b"")
        late.lose()

    def test_poses_of_a_tracker_are_taken(self):
        tracker, encoder, decoder = handcast.Tracker(fps=25.0), handcast.LiveEncoder(rate=25.0), handcast.LiveDecoder()
        poses = []
        for k, frame in enumerate(pictures(70)):
            poses += decoder.push(encoder.push(tracker.push(frame), k / 25, skin_tone=tracker.skin_tone))
        poses += decoder.push(encoder.finish())
        self.assertGreater(len(poses), 40)
        self.assertEqual({pose.side for pose in poses}, {"right"})

    def test_errors_name_the_argument(self):
        encoder = handcast.LiveEncoder()
        hand = handcast.Hand("left", np.zeros((1, 29)))
        encoder.push([hand], 1.0)
        for words, call in (
            (["rate", "allowed"], lambda: handcast.LiveEncoder(rate=0)),
            (["one of them"], lambda: handcast.LiveEncoder(quant=3, bitrate=1.0)),
            (["time is 0.5 s", "not after the 1 s"], lambda: encoder.push([hand], 0.5)),
            (["time is NaN"], lambda: encoder.push([hand], float("nan"))),
            (["skin_tone", "1 to 10"], lambda: encoder.push([hand], skin_tone=11)),
        ):
            with self.assertRaises(handcast.Error) as caught:
                call()
            for word in words:
                self.assertIn(word, str(caught.exception))
        with self.assertRaisesRegex(TypeError, r"poses\[1\] is .*int.*, allowed Pose and Hand"):
            encoder.push([hand, 3])
        with self.assertRaisesRegex(TypeError, "data is .*str.*, allowed bytes"):
            handcast.LiveDecoder().push("text")


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
        self.refused(["times is 2", "allowed 3 seconds"], handcast.Hand, "left", np.zeros((3, 29)), times=np.zeros(2))
        hand = handcast.Hand("left", np.zeros((3, 29)))
        self.refused(["hands", "twice"], handcast.Clip, [hand, hand])
        holed = np.zeros((3, 29))
        holed[2, 4] = np.nan
        self.refused([f"{handcast.ANGLES[4]} of frame 2"], handcast.Hand, "left", holed)
        zeros = np.zeros((2, 29))
        self.refused(["times: frame 1", "not after"], handcast.Hand, "left", zeros, times=[1, 1])
        self.refused(["confidence: frame 1", "2"], handcast.Hand, "left", zeros, confidence=[1, 2])
        far = np.stack([np.eye(4)] * 2)
        far[1, 0, 3] = 5000
        self.refused(["wrist: frame 1", "1000 m"], handcast.Hand, "left", zeros, wrist=far)
        self.refused(["angles: frame 0", "degrees"], handcast.Hand, "left", zeros + 7)
        self.refused(["side", "left"], handcast.Hand, "both", zeros)
        self.refused(["rate is 0", "allowed"], handcast.Hand, "left", zeros, rate=0)
        self.refused(["rate is 25", "times", "one of the two"], handcast.Hand, "left", zeros, times=[0, 1], rate=25)
        self.refused(["rate is -1"], handcast.Clip, [hand], -1)
        self.refused(["angles", "T x 29"], handcast.Hand, "left", [[1, 2], [3]])
        self.refused(["angles", "complex128"], handcast.Hand, "left", np.zeros((2, 29), complex))
        self.refused(["valid", "int64"], handcast.Hand, "left", np.zeros((2, 29)), valid=np.zeros(2, np.int64))
        clip = handcast.Clip([hand])
        self.refused(["one of them"], handcast.encode, clip, quant=3, bitrate=1.0)
        self.refused(["format", "glb"], handcast.to_format, clip, "fbx")
        self.refused([], handcast.Tracker().finish)
        for aim in ({"quant": 300}, {"quant": -1}, {"quant": 2.5}, {"target_rms": -1}, {"bitrate": float("nan")}, {"intra": 0}):
            self.refused([*aim, "allowed"], handcast.encode, clip, **aim)
        self.refused(["max_error", "0.15"], handcast.encode, clip, max_error=0.1)
        self.refused(["skin_tone", "1 to 10"], handcast.Clip, [hand], skin_tone=300)
        self.refused(["smooth", "two numbers"], handcast.track, DEMO, smooth=[1.0])
        self.refused(["smooth[0]"], handcast.track, DEMO, smooth=np.array([1000.0, 0.1]))
        self.refused(["fov"], handcast.track, DEMO, fov="wide", kind=TypeError)

    def test_files_that_are_not_there_are_pythons_own_errors(self):
        none = self.folder / "none"
        for call, more in ((handcast.load, {}), (handcast.track, {})):
            with self.assertRaises(FileNotFoundError) as caught:
                call(none, **more)
            self.assertEqual((caught.exception.filename, caught.exception.errno), (str(none), 2))
        self.refused(["none"], handcast.track, DEMO, net=none, kind=FileNotFoundError)
        self.refused(["none.toml"], handcast.track, DEMO, person=self.folder / "none.toml", kind=FileNotFoundError)
        self.refused([], handcast.load, self.folder, kind=IsADirectoryError)

    def test_networks_are_found_as_the_program_finds_them(self):
        before = os.environ.get("HANDCAST_NET")
        self.addCleanup(lambda: os.environ.pop("HANDCAST_NET") if before is None else os.environ.update(HANDCAST_NET=before))
        os.environ["HANDCAST_NET"] = str(self.folder / "none.whl")
        self.refused(["HANDCAST_NET", "none.whl"], handcast.track, DEMO)
        self.refused(["HANDCAST_NET"], handcast.Tracker)
        handcast.Tracker(net=False)
        os.environ["HANDCAST_NET"] = "none"
        handcast.Tracker()

    def test_numbers_of_any_kind_are_taken(self):
        angles = np.arange(58).reshape(2, 29) / 64
        hand = handcast.Hand("left", angles)
        self.assertEqual(handcast.Hand("left", angles.astype(np.float32)), hand)
        self.assertEqual(handcast.Hand("left", angles.tolist(), times=[0, 1 / 30], valid=[True, True]), hand)
        self.assertEqual(handcast.Hand("left", np.zeros((2, 29), np.int32)), handcast.Hand("left", np.zeros((2, 29))))

    @unittest.skipUnless(hasattr(signal, "setitimer"), "no timers")
    def test_ctrl_c_ends_the_wait_for_a_stream(self):
        t = np.arange(20000)[:, None] / 30
        clip = handcast.Clip([handcast.Hand("right", 0.5 + 0.4 * np.sin(t * np.linspace(1, 5, 29)))], 30.0)

        def ends(*_):
            raise KeyboardInterrupt

        self.addCleanup(signal.signal, signal.SIGALRM, signal.signal(signal.SIGALRM, ends))
        signal.setitimer(signal.ITIMER_REAL, 0.3)
        begun = time.monotonic()
        with self.assertRaises(KeyboardInterrupt):
            handcast.encode(clip)
        self.assertLess(time.monotonic() - begun, 2.0)

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
