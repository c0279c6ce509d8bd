"""Hands in video as numpy arrays, as streams of one to two kilobits per second, and as animated glTF.

>>> import handcast
>>> clip = handcast.track("clip.mp4")
>>> clip.right.angles.shape, clip.right.joints.shape
((300, 29), (300, 25, 3))
>>> stream = handcast.encode(clip)
>>> open("hand.glb", "wb").write(handcast.to_glb(handcast.decode(stream)))

Angles are radians, lengths metres, times seconds. Space is right-handed with the camera at its origin: x right, y up, z
towards the viewer. The work is done without Python's lock, so threads run side by side. Clips, hands and poses can be pickled.

What the command says on standard error of times that are resampled, poses out of reach and bytes left out is a warning
here: HandcastWarning.
"""

from . import _handcast
from ._handcast import (
    ANGLES,
    JOINTS,
    Clip,
    Error,
    Hand,
    HandcastWarning,
    LiveDecoder,
    LiveEncoder,
    Pose,
    __version__,
    decode,
    encode,
    load,
    to_format,
    to_glb,
    to_pose_format,
)

__all__ = [
    "ANGLES",
    "JOINTS",
    "Clip",
    "Error",
    "Hand",
    "HandcastWarning",
    "LiveDecoder",
    "LiveEncoder",
    "Pose",
    "Tracker",
    "__version__",
    "decode",
    "encode",
    "load",
    "to_format",
    "to_glb",
    "to_pose_format",
    "track",
]


def _words(hand, view, mirror, start, smooth, person, hand_length, fov, net):
    return dict(
        hand=hand,
        view=view,
        mirror=mirror,
        start=start,
        smooth=smooth,
        person=person,
        hand_length=hand_length,
        fov=fov,
        net=net,
    )


def track(
    source,
    *,
    fps=None,
    hand=None,
    view=None,
    mirror=False,
    start="open",
    smooth=None,
    person=None,
    hand_length=0.189,
    fov=60.0,
    net=None,
):
    """The poses of the hands in a clip: a file, a folder or pattern of pictures, or frames.

    source: a path, or an iterable of arrays H×W×3 of uint8, RGB.
    fps: frames per second of frames and pictures (30 where it is not given).
    hand: "left" or "right" alone; else one hand or two, whichever there are.
    view: "palm" or "back", the face that the camera sees.
    mirror: the clip is a mirrored selfie view.
    start: "open" waits for the five fingers to be spread once; "any" starts from any posture.
    smooth: (cut-off at rest in Hz, its growth in Hz per degree per second) of the 1€ filter, such as (1.0, 0.05).
    person: a file with the person's sizes.
    hand_length: wrist to middle fingertip, metres.
    fov: degrees that the camera sees across the longer side.
    net: MediaPipe's wheel, .task or .tflite files, with which hands are found before any background; None for those that
        HANDCAST_NET names or pip or npm installed, as the command has it; False for none.

    Raises Error where there is no hand to be found or the clip is damaged, FileNotFoundError and other OSError.
    """
    return _handcast.track(source, fps, _words(hand, view, mirror, start, smooth, person, hand_length, fov, net))


class Tracker:
    """Frames in, poses out, as they come: live pictures. The keywords are those of track().

    Poses come late where they must: colours are learnt from the first 48 frames that show any, and a hand is tracked once it has been
    seen open, from there back to the first frame. After that each frame gives its poses at once. clip() makes a Clip of them, with
    all that track() says of it.
    """

    def __init__(
        self,
        *,
        fps=30.0,
        hand=None,
        view=None,
        mirror=False,
        start="open",
        smooth=None,
        person=None,
        hand_length=0.189,
        fov=60.0,
        net=None,
    ):
        words = _words(hand, view, mirror, start, smooth, person, hand_length, fov, net)
        self._tracker = _handcast.Tracker(fps, words)

    def push(self, frame, time=None):
        """The poses (list of Pose) that are known with this frame: an array H×W×3 of uint8, RGB, at `time` seconds, by
        default its number over the rate."""
        return self._tracker.push(frame, time)

    def finish(self):
        """No more frames come: the poses (list of Pose) that are left."""
        return self._tracker.finish()

    def clip(self, poses):
        """Poses of this tracker as a Clip, with the hands' sizes and the tone of the skin as they are known by now: of all
        poses, after finish(), the clip of track(). Its rate is `fps`, or that of the times where frames came with some."""
        return self._tracker.clip(poses)

    @property
    def skin_tone(self):
        """Tone of the skin, 1 (lightest) to 10; None where it is not known yet."""
        return self._tracker.skin_tone
