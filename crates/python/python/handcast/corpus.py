"""A corpus on many machines: ``python -m handcast.corpus --scheduler ADDRESS IN OUT``.

Does what ``handcast corpus`` does on one machine, with the workers of a Dask scheduler: the same streams, manifest, failures
and report in OUT, and each goes on with what the other began. IN and OUT are folders that all machines see under the same
path. Only this program writes the manifest; a worker writes streams, each under its name when it is whole. What a worker
that dies was at is done by another.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from . import Error, __version__
from ._handcast import Corpus, Worker, check_run, given_up, net_digest, read_person

#: Inputs that wait at the scheduler for each thread of a worker: enough that none is idle.
AHEAD = 4


_workers = lru_cache(maxsize=4)(Worker)


def work(input: str, output: str, settings: str, net: str | None, version: str, item: str) -> str:
    """The outcome of one input, as JSON; runs on a worker."""
    if version != __version__:
        raise Error(f"this worker has handcast {__version__}, the run {version}")
    return _workers(input, output, settings, net).work(item)


def run(
    scheduler: str,
    input: str | Path,
    output: str | Path,
    settings: dict[str, Any] | None = None,
    *,
    only: Sequence[str] = (),
    checksum: bool = False,
    retry: bool = False,
    net: str | Path | bool | None = None,
    quiet: bool = True,
) -> dict[str, Any]:
    """Does all inputs of a folder with the workers of a scheduler; the facts of the report.

    settings: as OUT/settings has them, what is left out as by default.
    only: patterns of names. checksum: read all inputs and streams to see what has changed, where else
    size and time of inputs and the size of streams tell. retry: try again what failed. net: MediaPipe's networks, which
    all workers see; None for those that HANDCAST_NET names or pip or npm installed, on each machine the same; False for none.

    Raises Error where the run cannot go on, before anything in OUT is touched where settings are wrong or no scheduler
    answers; what is wrong with single inputs is in OUT/failures.jsonl.
    """
    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError as error:
        raise Error("the package dask is missing: pip install 'dask[distributed]'") from error

    places = str(Path(input).resolve()), str(Path(output).resolve())
    given = str(Path(net).resolve()) if isinstance(net, (str, Path)) else None
    text = _checked(settings or {}, list(only), given if given is not None else net)
    if not Path(input).is_dir():
        raise Error(f"{input}: no such folder")
    try:
        client = Client(scheduler, timeout=30)
    except (OSError, TimeoutError, ValueError) as error:
        raise Error(f"{scheduler}: no scheduler answers: {error}") from error
    with client:
        corpus = Corpus(input, output, text, list(only), checksum, retry)
        waiting = deque(corpus.todo())
        digest = corpus.settings()
        shown = _Shown(len(waiting), quiet)
        items: dict[object, str] = {}
        done = as_completed()

        def submit(count: int) -> None:
            for _ in range(min(count, len(waiting))):
                item = waiting.popleft()
                # What was done for another run is not to be taken for this one's.
                future = client.submit(work, *places, text, given, __version__, item, pure=False)
                items[future.key] = item
                done.add(future)

        threads = sum(client.nthreads().values())
        submit(AHEAD * max(threads, 1))
        for future in done:
            item = items.pop(future.key)
            failure = future.exception()
            if failure is None:
                outcome = future.result()
            elif isinstance(failure, KilledWorker):
                outcome = given_up(item, digest, "each worker that was at it has died")
            else:
                # Nothing can be written, or the worker is another version: so it would be for all others.
                client.cancel(list(items))
                raise failure if isinstance(failure, Error) else Error(f"{json.loads(item)['name']}: {failure}")
            shown.done(corpus.record(outcome), len(waiting) + len(items))
            # Workers may come and go.
            submit(AHEAD * max(sum(client.nthreads().values()), 1) - len(items))
    said, facts = corpus.finish()
    if not quiet:
        print(said, end="")
    summary: dict[str, Any] = json.loads(facts)
    return summary


def _checked(settings: dict[str, Any], only: list[str], net: str | Path | bool | None) -> str:
    """The settings as JSON, which name the networks."""
    try:
        text = json.dumps(settings, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise Error(f"settings: {error}") from error
    check_run(text, only)
    track = settings.get("track", {})
    finder = track.get("finder") or net_digest(net)
    return json.dumps({**settings, "track": {**track, "finder": finder}})


class _Shown:
    """A line about how far it is, on standard error, twice a second on a terminal and once a minute elsewhere."""

    def __init__(self, total: int, quiet: bool) -> None:
        self.total, self.failed = total, 0
        self.begun = self.told = time.monotonic()
        self.terminal = sys.stderr.isatty()
        self.every = float("inf") if quiet else 0.5 if self.terminal else 60.0

    def done(self, worked: bool, left: int) -> None:
        self.failed += not worked
        now = time.monotonic()
        if now - self.told < self.every and (left or not self.terminal or self.every > 60):
            return
        self.told = now
        count = self.total - left
        minutes = (now - self.begun) / max(count, 1) * left / 60
        line = f"{count} of {self.total} inputs, {self.failed} failed, {minutes:.1f} minutes left"
        print(f"\r{line} " if self.terminal else line, end="" if self.terminal and left else "\n", file=sys.stderr)


def _number(allowed: str, fits: Callable[[float], bool]) -> Callable[[str], float]:
    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not fits(value):
            raise argparse.ArgumentTypeError(f"{text}: allowed {allowed}")
        return value

    return number


def _within(least: float, most: float, unit: str) -> Callable[[str], float]:
    return _number(f"{least:g} to {most:g} {unit}", lambda value: least <= value <= most)


_positive = _number("are numbers above 0", lambda value: 0 < value < math.inf)
_index = _number("whole numbers 0 to 31", lambda value: 0 <= value <= 31 and value == int(value))


def _error_aim(text: str) -> dict[str, float]:
    if text.endswith("mm"):
        return {"tip_error": _within(0.75, 1000, "mm")(text[:-2])}
    return {"max_error": _within(0.15, 180, "degrees")(text)}


def _smooth(text: str) -> list[float]:
    parts = text.split(",")
    if len(parts) != 2:
        raise argparse.ArgumentTypeError(f"{text}: allowed two numbers, as in 1,0.05")
    return [_within(0.01, 100, "Hz")(parts[0]), _within(0, 10, "Hz per degree per second")(parts[1])]


def _arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m handcast.corpus",
        description="A folder of clips and motion files to a folder of streams, by the workers of a Dask scheduler; as "
        "`handcast corpus` does it on one machine.",
    )
    parser.add_argument("input", metavar="IN", help="folder with clips and motion files, which all workers see")
    parser.add_argument("output", metavar="OUT", help="folder for the results, which all workers see")
    parser.add_argument("--scheduler", required=True, metavar="ADDRESS", help="such as tcp://host:8786")
    parser.add_argument("--match", "--only", dest="only", action="append", default=[], metavar="PATTERN", help='such as "*.mp4"; may be repeated')
    parser.add_argument(
        "--checksum",
        action="store_true",
        help="read all inputs and streams to see what has changed; else their sizes, and the times of inputs, tell",
    )
    parser.add_argument("--retry", action="store_true", help="try inputs again that failed")
    parser.add_argument("-q", "--quiet", action="store_true", help="no progress, no report on standard output")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    track = parser.add_argument_group("tracking")
    track.add_argument("--hand", choices=["left", "right"])
    track.add_argument("--view", choices=["palm", "back"])
    track.add_argument("--mirror", action="store_true")
    track.add_argument("--start", choices=["open", "any"], default="open")
    track.add_argument("--smooth", metavar="MIN_CUTOFF,BETA", type=_smooth)
    track.add_argument("--person", metavar="FILE")
    track.add_argument("--hand-length-mm", type=_within(50, 400, "mm"), metavar="MM")
    track.add_argument("--fov", type=_within(5, 150, "degrees"), metavar="DEG")
    track.add_argument("--from", dest="begin", type=_within(0, 1e6, "s"), metavar="S", help="begin at this time of each clip, seconds")
    track.add_argument("--until", type=_within(0, 1e6, "s"), metavar="S", help="end before the picture at this time of each clip")
    nets = track.add_mutually_exclusive_group()
    nets.add_argument(
        "--net", metavar="FILE", help="MediaPipe's networks, which all workers see; else $HANDCAST_NET, or where pip and npm put them"
    )
    nets.add_argument("--no-net", action="store_true", help="use no networks, even where they are")
    encode = parser.add_argument_group("encoding")
    aim = encode.add_mutually_exclusive_group()
    aim.add_argument("--target-rms", type=lambda text: {"rms": _positive(text)}, dest="aim", metavar="DEG")
    aim.add_argument("--max-error", type=_error_aim, dest="aim", metavar="DEG|MM")
    aim.add_argument("--bitrate", type=lambda text: {"bitrate": _positive(text)}, dest="aim", metavar="KBPS")
    aim.add_argument("--quant", type=lambda text: {"quant": int(_index(text))}, dest="aim", metavar="0-31")
    encode.add_argument("--intra", type=_positive, metavar="S")
    encode.add_argument("--resync", action="store_true")
    encode.add_argument("--no-sizes", action="store_true")
    encode.add_argument("--derive", action="store_true")
    return parser.parse_args(words)


def _settings(args: argparse.Namespace) -> dict[str, Any]:
    track = {
        "hand": args.hand,
        "view": args.view,
        "mirror": args.mirror,
        "start_any": args.start == "any",
        "smooth": args.smooth,
        "person": json.loads(read_person(args.person)) if args.person else None,
        "hand_length": args.hand_length_mm and args.hand_length_mm / 1000,
        "field_of_view": args.fov,
        "from": args.begin,
        "until": args.until,
    }
    encode = {
        "aim": args.aim,
        "intra_seconds": args.intra,
        "resync": args.resync,
        "no_sizes": args.no_sizes,
        "derive": args.derive,
    }
    # What is not said is as by default.
    return {
        name: {key: value for key, value in group.items() if value is not None}
        for name, group in (("track", track), ("encode", encode))
    }


def main(words: Sequence[str] | None = None) -> int:
    """The command; its exit code: 0 done, 1 failed (2, wrong usage, is argparse's own)."""
    args = _arguments(words)
    try:
        facts = run(
            args.scheduler,
            args.input,
            args.output,
            _settings(args),
            only=args.only,
            checksum=args.checksum,
            retry=args.retry,
            net=False if args.no_net else args.net,
            quiet=args.quiet or args.json,
        )
        if args.json:
            print(json.dumps(facts, indent=2))
        if facts["clips"] == 0:
            raise Error(f"none of {facts['failures']} inputs could be done: {Path(args.output) / 'failures.jsonl'}")
    except (Error, OSError) as error:
        print(f"handcast.corpus: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    # Workers take `work` by the name of its module, which is another one here.
    from handcast import corpus

    sys.exit(corpus.main())
