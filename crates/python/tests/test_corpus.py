"""A corpus by the workers of a Dask scheduler, one of which is killed."""

import json
import shutil
import subprocess
import sys
import time
import unittest

import handcast.corpus
from common import ROOT, InFolder, done


def names(file):
    return [json.loads(line)["name"] for line in file.read_text().splitlines()]


class Corpus(InFolder):
    """The program's results beside those of workers."""

    def setUp(self):
        super().setUp()
        self.input = self.folder / "in"
        (self.input / "a").mkdir(parents=True)
        clip = self.input / "a" / "clip-00.avi"
        done("synth", "-o", clip, "--frames", 30, "--size", "320x240", "--poses", self.folder / "truth.jsonl")
        for i in range(1, 24):
            shutil.copy(clip, clip.with_name(f"clip-{i:02}.avi"))
        shutil.copy(ROOT / "fixtures" / "demo.poses.jsonl", self.input / "demo.jsonl")
        (self.input / "broken.mp4").write_bytes(b"no video")
        # What the program makes of it.
        self.native = self.folder / "native"
        done("corpus", self.input, "-o", self.native)
        self.processes = []
        self.addCleanup(lambda: [process.kill() or process.wait() for process in self.processes])

    def started(self, *words):
        process = subprocess.Popen([sys.executable, "-m", "dask", *map(str, words)], stderr=subprocess.DEVNULL)
        self.processes.append(process)
        return process

    def cluster(self):
        """A scheduler and two workers of a thread each."""
        file = self.folder / "scheduler.json"
        self.started("scheduler", "--port", 0, "--no-dashboard", "--host", "127.0.0.1", "--scheduler-file", file)
        local = self.folder / "dask"
        words = ["--nthreads", 1, "--no-nanny", "--no-dashboard", "--local-directory", local]
        workers = [self.started("worker", "--scheduler-file", file, *words) for _ in range(2)]
        from distributed import Client

        deadline = time.monotonic() + 60
        while not file.exists():
            self.assertLess(time.monotonic(), deadline, "no scheduler")
            time.sleep(0.05)
        with Client(scheduler_file=str(file), timeout=30) as client:
            client.wait_for_workers(2, timeout=60)
        return json.loads(file.read_text())["address"], workers

    def command(self, address, out, *more):
        words = [sys.executable, "-m", "handcast.corpus", "--scheduler", address, self.input, out, *more]
        return subprocess.Popen([*map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def assert_same(self, out):
        """The results are the program's, byte for byte."""
        for name in ("manifest.jsonl", "failures.jsonl"):
            self.assertEqual((out / name).read_text(), (self.native / name).read_text(), name)
        streams = {
            folder: {file.relative_to(folder): file.read_bytes() for file in (folder / "streams").rglob("*") if file.is_file()}
            for folder in (out, self.native)
        }
        self.assertEqual(streams[out], streams[self.native])

    def test_a_killed_worker_loses_nothing_and_a_killed_run_goes_on(self):
        address, workers = self.cluster()
        out = self.folder / "out"
        manifest = out / "manifest.jsonl"

        def lines():
            return len(manifest.read_bytes().splitlines()) if manifest.exists() else 0

        def wait_for(count, run):
            deadline = time.monotonic() + 120
            while lines() < count:
                self.assertLess(time.monotonic(), deadline, "no streams")
                self.assertIsNone(run.poll(), "it was done too early")
                time.sleep(0.005)

        # The run itself is killed, and the next goes on.
        run = self.command(address, out)
        wait_for(3, run)
        run.kill()
        run.communicate()
        before = lines()
        self.assertLess(before, 25)
        # A worker is killed: what it was at, the other does.
        run = self.command(address, out)
        wait_for(before + 4, run)
        second = handcast.corpus
        with self.assertRaisesRegex(handcast.Error, "another run"):
            second.run(address, self.input, out)
        workers[0].kill()
        said, complained = run.communicate(timeout=300)
        self.assertEqual(run.returncode, 0, complained)
        self.assertEqual(names(manifest), sorted(set(names(manifest))))
        self.assertEqual(len(names(manifest)), 25)
        self.assertIn("1 failed", said)
        self.assert_same(out)
        # There is nothing left to do, for either.
        facts = handcast.corpus.run(address, self.input, out)
        self.assertEqual((facts["run"]["before"], facts["run"]["done"]), (25, 0))
        self.assertIn("0 done, 0 failed, 25 done before, 1 failed before", done("corpus", self.input, "-o", out))
        # What the program began, workers end.
        mixed = self.folder / "mixed"
        done("corpus", self.input, "-o", mixed, "--only", "a/clip-0*")
        facts = handcast.corpus.run(address, self.input, mixed)
        self.assertEqual((facts["run"]["before"], facts["run"]["done"], facts["run"]["failed"]), (10, 15, 1))
        self.assert_same(mixed)

    def test_wrong_calls_are_told(self):
        out = self.folder / "out"
        run = self.command("tcp://127.0.0.1:9", out)
        _, complained = run.communicate(timeout=120)
        self.assertEqual(run.returncode, 1)
        self.assertIn("no scheduler answers", complained)
        self.assertFalse(out.exists())
        for words in ("--quant x", "--quant 99", "--quant 2.5", "--target-rms -1", "--intra 0", "--bitrate nan", "--smooth a,b"):
            option, value = words.split()
            run = self.command("tcp://127.0.0.1:9", out, f"{option}={value}")
            _, complained = run.communicate(timeout=60)
            self.assertEqual(run.returncode, 2, complained)
            self.assertRegex(complained, f"argument {option}: .*: allowed")
        with self.assertRaisesRegex(handcast.Error, "no such folder"):
            handcast.corpus.run("tcp://127.0.0.1:9", self.folder / "none", out)
        with self.assertRaisesRegex(handcast.Error, "settings"):
            handcast.corpus.run("tcp://127.0.0.1:9", self.input, out, {"trak": {}})
        for settings, word in (
            ({"track": {"field_of_view": 1000}}, "field_of_view is 1000"),
            ({"track": {"hand_length": 189}}, "hand_length is 189"),
            ({"track": {"from": 2, "until": 1}}, "until is 1"),
            ({"encode": {"aim": {"bitrate": float("nan")}}}, "JSON"),
            ({"encode": {"aim": {"quant": 99}}}, "quant is 99"),
            ({"encode": {"intra_seconds": 0}}, "intra_seconds is 0"),
        ):
            with self.assertRaisesRegex(handcast.Error, f"settings: .*{word}"):
                handcast.corpus.run("tcp://127.0.0.1:9", self.input, out, settings)
        with self.assertRaisesRegex(handcast.Error, "only"):
            handcast.corpus.run("tcp://127.0.0.1:9", self.input, out, only=["[a"])
        # What is there already stays, whatever is wrong with the call.
        before = {file: file.read_bytes() for file in self.native.rglob("*") if file.is_file()}
        self.assertEqual(self.command("tcp://127.0.0.1:9", self.native, "--quant", 12).wait(120), 1)
        self.assertEqual({file: file.read_bytes() for file in self.native.rglob("*") if file.is_file()}, before)


if __name__ == "__main__":
    unittest.main()
