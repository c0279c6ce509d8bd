"""Time and results of networks beside LiteRT's: beside_litert.py BENCH_NET NET...

BENCH_NET is the built example of this crate. Both run on one thread, in turn, so that both see the same load of the machine.
Needs the packages numpy and ai-edge-litert.
"""

import pathlib
import subprocess
import sys
import tempfile
import time

import numpy
from ai_edge_litert.interpreter import Interpreter

ROUNDS, RUNS = 10, 20


def main(bench, nets):
    for net in nets:
        interpreter = Interpreter(net, num_threads=1)
        interpreter.allocate_tensors()
        entry = interpreter.get_input_details()[0]
        picture = numpy.random.default_rng(1).random(entry["shape"], dtype=numpy.float32)
        interpreter.set_tensor(entry["index"], picture)
        interpreter.invoke()
        theirs = [interpreter.get_tensor(o["index"]).copy() for o in interpreter.get_output_details()]
        with tempfile.TemporaryDirectory() as folder:
            given, made = pathlib.Path(folder, "in"), pathlib.Path(folder, "out")
            picture.tofile(given)
            times = []
            for _ in range(ROUNDS):
                each = []
                for _ in range(RUNS):
                    start = time.thread_time()
                    interpreter.invoke()
                    each.append(time.thread_time() - start)
                out = subprocess.run(
                    [bench, net, str(RUNS), given, made], check=True, capture_output=True, text=True
                ).stdout.split()
                times.append((1e3 * sum(each) / RUNS, 1e3 * min(each), float(out[0]), float(out[1])))
            ours = numpy.fromfile(made, numpy.float32)
        theirs = numpy.concatenate([t.ravel() for t in theirs])
        mean = numpy.median(numpy.array(times), axis=0)
        best = numpy.min(numpy.array(times), axis=0)
        print(
            f"{pathlib.Path(net).stem}: median of means {mean[0]:.2f} ms LiteRT, {mean[2]:.2f} ms here, ratio "
            f"{mean[2] / mean[0]:.2f}; best {best[1]:.2f}, {best[3]:.2f}, ratio {best[3] / best[1]:.2f}; "
            f"largest difference {numpy.abs(theirs - ours).max():.2g} of {numpy.abs(theirs).max():.3g}"
        )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
