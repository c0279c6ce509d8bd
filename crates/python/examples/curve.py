"""Plots how far each finger is bent in a clip, and how sure the tracker is: python curve.py CLIP curve.png"""

import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import handcast

source, picture = sys.argv[1:3]

# %% From pixels to angles: T×29 radians a hand.
clip = handcast.track(source)
hand = clip.hands[0]
print(f"{clip}: {len(hand)} poses of the {hand.side} hand, {hand.valid.mean():.0%} tracked, {clip.rate:g} a second")

# %% A stream of one to two kilobits per second, and what comes back.
stream = handcast.encode(clip)
back = handcast.decode(stream).hands[0]
print(f"{len(stream)} bytes, {len(stream) * 8e-3 / np.ptp(hand.times):.2f} kbit/s")

# %% The curves: the middle joint of each finger (of the thumb the end joint), as tracked and as decoded.
figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(10, 6), height_ratios=[3, 1])
for finger, joint in zip(("thumb", "index", "middle", "ring", "pinky"), (3, 2, 2, 2, 2)):
    column = handcast.ANGLES.index(f"{finger}{joint}_flexion")
    (line,) = above.plot(hand.times, np.degrees(hand.angles[:, column]), label=finger)
    above.plot(back.times, np.degrees(back.angles[:, column]), ":", color=line.get_color())
above.set_ylabel("flexion, degrees (dotted: decoded)")
above.legend(ncols=5)
below.plot(hand.times, hand.confidence, color="grey")
below.set(ylim=(0, 1), ylabel="confidence", xlabel="seconds")
figure.savefig(picture, dpi=100, bbox_inches="tight")
