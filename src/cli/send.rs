//! `handcast send`: the moving hand to other programs, at its own pace.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, ensure};
use handcast_hand::{PoseClip, Side, TimedPose};

use super::common::{Hand, check_seen};
use super::ending::told_to_stop;
use super::motion::MotionArgs;
use super::receivers::Receivers;
use super::usage::within;

/// Poses of two hands closer in time than this, seconds, are of one instant.
const SAME: f64 = 1e-4;

/// Sends the moving hand to other programs at its own pace
///
/// VTuber programs, Unity, Unreal, Blender and Godot take it by the VMC protocol, OSC over UDP: to the own machine or a local network.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Receiver of VMC packets; the port is 39539 where none is given. Several times: several receivers
    #[arg(long, value_name = "HOST:PORT", required = true)]
    vmc: Vec<String>,
    /// How fast, times the recording's own pace, 0.01 to 100
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = speed)]
    speed: f64,
    /// Begin again at the end, until Ctrl-C
    #[arg(long = "loop")]
    again: bool,
    /// Send this hand alone
    #[arg(long, value_enum, value_name = "HAND")]
    only: Option<Hand>,
    /// Leave out the rotation of the hand itself, for receivers that place hands themselves
    #[arg(long)]
    fingers: bool,
    /// Neither progress nor report; warnings are told all the same
    #[arg(short, long)]
    quiet: bool,
    #[command(flatten)]
    motion: MotionArgs,
}

fn speed(text: &str) -> Result<f64, String> {
    within(text, 0.01..=100.0, "")
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let mut receivers = Receivers::connect(&args.vmc, !args.fingers).context("--vmc")?;
    let name = || args.motion.input.display().to_string();
    let motion = args.motion.read()?;
    for note in &motion.notes {
        errln!("handcast: {}: {note}", name());
    }
    for side in [Side::Left, Side::Right] {
        let sizes = motion.clip.header.hand(side).and_then(|hand| hand.morphology.as_ref());
        receivers.set_sizes(side, sizes.unwrap_or(&motion.morphology));
    }
    check_seen(name(), &motion.clip)?;
    let moments = moments(motion.clip, args.only.map(Side::from));
    let sent = moments.iter().flatten().any(|pose| pose.valid);
    ensure!(sent, "{}: there is no pose to send of this hand; it has the other one alone", name());
    if !args.quiet {
        let addresses: Vec<_> = receivers.sent().map(|(address, _)| address.to_string()).collect();
        errln!("sending to {}, Ctrl-C ends it", addresses.join(", "));
    }
    // Receivers are told at the end, however it comes, that no hand is tracked any more.
    let clock = Clock { start: Instant::now(), stop: told_to_stop() };
    let mut now = 0.0;
    loop {
        now = play(&mut receivers, &moments, &clock, now, args.speed)?;
        if !args.again || clock.is_stopped() {
            break;
        }
    }
    let ended = receivers.end(now);
    if receivers.sent().all(|(_, sent)| sent.packets == 0) {
        ended?;
    }
    for (address, sent) in receivers.sent().filter(|_| !args.quiet) {
        let to = if args.vmc.len() > 1 { format!("{address}: ") } else { String::new() };
        outln!(
            "{to}{} poses in {} packets, {:.0} kbit/s for {now:.1} s",
            sent.poses,
            sent.packets,
            sent.bytes as f64 * 8e-3 / now.max(1e-3)
        );
    }
    receivers.tell_unheard();
    Ok(())
}

/// The poses of all hands, by instants.
fn moments(clip: PoseClip, only: Option<Side>) -> Vec<Vec<TimedPose>> {
    let mut poses = clip.frames;
    poses.retain(|pose| only.is_none_or(|side| pose.pose.side == side));
    poses.sort_by(|a, b| a.time.total_cmp(&b.time));
    let mut moments: Vec<Vec<TimedPose>> = Vec::new();
    for pose in poses {
        match moments.last_mut() {
            Some(moment) if pose.time - moment[0].time < SAME => moment.push(pose),
            _ => moments.push(vec![pose]),
        }
    }
    moments
}

/// What poses are timed by.
struct Clock {
    start: Instant,
    /// Becomes true where the program is told to end.
    stop: Arc<AtomicBool>,
}

impl Clock {
    /// Longest sleep, after which is looked whether to end.
    const NAP: Duration = Duration::from_millis(50);

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Sleeps until so much time has passed; false if the program is told to end before.
    fn sleep_until(&self, due: Duration) -> bool {
        loop {
            let left = due.saturating_sub(self.start.elapsed());
            if left.is_zero() || self.is_stopped() {
                return !self.is_stopped();
            }
            thread::sleep(left.min(Self::NAP));
        }
    }
}

/// Sends a recording once, from `begin` seconds on; gives when the next one may begin, an interval after the last pose, or when it
/// was ended.
fn play(
    receivers: &mut Receivers,
    moments: &[Vec<TimedPose>],
    clock: &Clock,
    begin: f64,
    speed: f64,
) -> anyhow::Result<f64> {
    let time = |moment: &Vec<TimedPose>| moment[0].time;
    let (Some(first), Some(last)) = (moments.first().map(time), moments.last().map(time)) else {
        return Ok(begin);
    };
    for moment in moments {
        let at = begin + (time(moment) - first) / speed;
        let due = Duration::try_from_secs_f64(at).context("the instant of a pose")?;
        if !clock.sleep_until(due) {
            return Ok(clock.start.elapsed().as_secs_f64());
        }
        receivers.send(at, clock.start.elapsed().as_secs_f64(), moment);
    }
    let intervals = moments.len().saturating_sub(1).max(1) as f64;
    let interval = if last > first { (last - first) / intervals } else { 1.0 };
    let end = begin + (last - first + interval) / speed;
    let whole = clock.sleep_until(Duration::try_from_secs_f64(end).unwrap_or_default());
    Ok(if whole { end } else { clock.start.elapsed().as_secs_f64() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::HandPose;

    #[test]
    fn hands_of_one_instant_go_together() {
        let at = |time: f64, side: Side| TimedPose::new(time, HandPose::neutral(side));
        let frames = vec![
            at(0.0, Side::Left),
            at(0.1, Side::Left),
            at(0.2, Side::Left),
            at(0.00001, Side::Right),
            at(0.15, Side::Right),
        ];
        let clip = PoseClip::of_frames(frames, None);
        let counts = |only| moments(clip.clone(), only).iter().map(Vec::len).collect::<Vec<_>>();
        assert_eq!(counts(None), [2, 1, 1, 1]);
        assert_eq!(counts(Some(Side::Right)), [1, 1]);
        let times: Vec<f64> = moments(clip.clone(), None).iter().map(|m| m[0].time).collect();
        assert_eq!(times, [0.0, 0.1, 0.15, 0.2]);
    }
}
