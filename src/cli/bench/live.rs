//! `handcast bench live`: what a room costs, on this machine alone.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context as _, ensure};
use handcast_formats::poses::read_poses;
use handcast_hand::smooth::{PoseSmoother, SmoothOptions};
use handcast_hand::{PoseClip, TimedPose};
use handcast_live::client::RoomClient;
use handcast_live::crowd::{Crowd, SentTimes};
use handcast_live::lossy::{LossyOptions, lossy_way};
use handcast_live::page;
use handcast_live::sender::{LivePoseEncoderOptions, PoseSender};
use handcast_live::server::{Counted, RoomPublisher, Server, ServerOptions, clock_ms};
use handcast_live::transport::{Publish as _, Subscribe as _};
use handcast_live::wire::{Message, Plane};
use handcast_media::OpenOptions;
use handcast_track::pipeline::{ClipOptions, Tracker};

use crate::cli::common::Scratch;
use crate::cli::demo_clip;
use crate::cli::loss::share;
use crate::cli::usage::positive;

/// Bytes of TCP and IP around a message of its own: 20 and 20, and 12 of time stamps.
const TCP_IP: u64 = 52;
/// Times that a clip is sent to count its bits, and those of them after which a stream has seen what moves how far.
const PASSES: usize = 6;
const SETTLED: usize = 2;
/// Times that a page is opened in a browser that runs.
const AGAIN: usize = 9;
/// Planes a second.
const RATE: f64 = 30.0;

/// Measures what a room costs on this machine: a thousand readers, bits on the wire, joining, and a browser
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Poses to send, 30 a second, steadied as by live; those of the built-in clip without
    poses: Option<PathBuf>,
    /// Readers at once
    #[arg(long, value_name = "N", default_value_t = 1000)]
    readers: usize,
    /// Seconds that they read
    #[arg(long, value_name = "S", default_value_t = 20.0, value_parser = positive)]
    seconds: f64,
    /// Chromium, for what it takes to draw, always by the processor
    #[arg(long, value_name = "FILE")]
    chromium: Option<PathBuf>,
    /// The script that opens pages in it; the default is in the folder of the sources
    #[arg(long, value_name = "FILE", default_value = "tests/node/live.js")]
    script: PathBuf,
    /// Share of the segments that are lost on a way to a viewer with 20 ms delay; several with commas
    #[arg(long, value_name = "SHARE", value_delimiter = ',', default_value = "1%,5%", value_parser = share)]
    loss: Vec<f64>,
    /// The program handcast-moq, to measure relays as well, which it starts
    #[arg(long, value_name = "FILE", conflicts_with = "json")]
    relays: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// The median, and what 95 and 99 of 100 keep to.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
struct Times {
    p50: f64,
    p95: f64,
    p99: f64,
}

impl Times {
    fn of(mut times: Vec<f64>) -> Self {
        times.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let last = times.len().saturating_sub(1);
            times.get((share * last as f64).round() as usize).copied().unwrap_or(f64::NAN)
        };
        Self { p50: at(0.5), p95: at(0.95), p99: at(0.99) }
    }
}

#[derive(Debug, serde::Serialize)]
struct Report {
    readers: usize,
    deliveries: usize,
    missed: u64,
    delivery_ms: Times,
    us_a_delivery: f64,
    /// Processor time of the room's thread for a delivery, microseconds, all else that it does included.
    cpu_us_a_delivery: Option<f64>,
    join_ms: Times,
    /// Payload and wire, kbit/s of a hand, of one plane, two and three a message: of the clip, and of its third to sixth time.
    kbit_per_s: [[[f64; 2]; 2]; 3],
    /// Resident before and behind the readers, MiB, and the growth over the second half of their time.
    resident_mib: Option<[f64; 3]>,
    /// From encoding to a viewer behind a way that loses segments: the share, and the times.
    lossy_ms: Vec<(f64, Times)>,
    /// To the moment at which a page begins to draw it, from its first skin on.
    encode_to_drawn_ms: Option<Times>,
    /// To the page's first turn that finds it drawn, before which no screen shows it: drawn by the processor, not by a
    /// graphics card.
    encode_to_shown_ms: Option<Times>,
    /// Poses of the two times above, and what they are of.
    page_poses: Option<PagePoses>,
    page_joins_ms: Option<Joins>,
}

/// How many poses a page drew: of several planes that come between two of its pictures it draws the last.
#[derive(Clone, Copy, Debug, serde::Serialize)]
struct PagePoses {
    /// Planes that it got, and poses that it drew.
    planes: u64,
    drawn: usize,
    /// Poses with a skin, and those of them that were found drawn.
    skinned: usize,
    shown: usize,
}

/// Milliseconds until a page has drawn its first hand.
#[derive(Clone, Copy, Debug, serde::Serialize)]
struct Joins {
    /// From opening it, as its browser's driver sees it.
    opened: f64,
    /// From asking for the room.
    asked: f64,
    /// From there until the hand has its skin.
    skinned: f64,
    /// From asking for the room in a browser that has been running, in the middle and the longest of [`AGAIN`].
    running: [f64; 2],
}

/// Runs the measurement.
pub fn run(args: &Args) -> anyhow::Result<()> {
    if args.chromium.is_some() && !args.script.is_file() {
        refuse!(
            "{}: no such script; --script names tests/node/live.js of the sources, where it lies elsewhere",
            args.script.display()
        );
    }
    let clip = match &args.poses {
        Some(path) => steadied(read_poses(path)?),
        None => demo_poses()?,
    };
    let kbit_per_s = [wire(&clip, 1)?, wire(&clip, 2)?, wire(&clip, 3)?];
    let join_ms = joins(&clip)?;
    let lossy_ms = args.loss.iter().map(|&loss| Ok((loss, lossy(&clip, loss, args.seconds)?)));
    let lossy_ms = lossy_ms.collect::<anyhow::Result<_>>()?;
    let mut report = crowd(args)?;
    report.lossy_ms = lossy_ms;
    report.join_ms = join_ms;
    report.kbit_per_s = kbit_per_s;
    if let Some(chromium) = &args.chromium {
        drawn(&clip, chromium, &args.script, &mut report)?;
    }
    if args.json {
        outln!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        tell(&report);
    }
    args.relays.as_deref().map_or(Ok(()), over_relays)
}

/// What rooms over relays cost, as `handcast-moq bench` tells.
fn over_relays(program: &Path) -> anyhow::Result<()> {
    let told = Command::new(program).arg("bench").stderr(Stdio::inherit()).output();
    let told = told.with_context(|| program.display().to_string())?;
    out!("{}", String::from_utf8_lossy(&told.stdout));
    ensure!(told.status.success(), "{}: failed", program.display());
    Ok(())
}

fn tell(report: &Report) {
    let times = |t: &Times| format!("p50 {:.1}, p95 {:.1}, p99 {:.1} ms", t.p50, t.p95, t.p99);
    outln!("{} readers, 30 planes/s      {}", report.readers, times(&report.delivery_ms));
    let cpu =
        report.cpu_us_a_delivery.map_or_else(String::new, |cpu| format!(" ({cpu:.1} of the processor)"));
    outln!(
        "  a delivery                 {:.1} µs{cpu}; {} of them, {} missed",
        report.us_a_delivery,
        report.deliveries,
        report.missed
    );
    outln!("joining, to the last pose    {}", times(&report.join_ms));
    for (what, [[payload, wire], [later, wire_later]]) in
        ["one plane a message ", "two planes a message", "three               "].iter().zip(report.kbit_per_s)
    {
        outln!(
            "{what}         {wire:.2} kbit/s a hand on the wire, {payload:.2} of them planes; later {wire_later:.2} and {later:.2}"
        );
    }
    for (loss, late) in &report.lossy_ms {
        outln!("20 ms away, {:.1} % lost       {}", loss * 100.0, times(late));
    }
    if let Some([before, behind, growth]) = report.resident_mib {
        outln!(
            "memory                       {before:.1} MiB, {behind:.1} with the readers, {growth:+.2} in the second half"
        );
    }
    tell_of_page(report);
}

/// What is told of a page.
fn tell_of_page(report: &Report) {
    let times = |t: &Times| format!("p50 {:.1}, p95 {:.1}, p99 {:.1} ms", t.p50, t.p95, t.p99);
    let all =
        (&report.encode_to_drawn_ms, &report.encode_to_shown_ms, report.page_poses, report.page_joins_ms);
    match all {
        (Some(drawn), Some(shown), Some(poses), Some(joins)) => {
            outln!("encoded to a page drawing it {}", times(drawn));
            outln!("to drawn by the processor    {}; no screen shows it before", times(shown));
            let PagePoses { planes, drawn, skinned, shown } = poses;
            outln!(
                "poses drawn                  {drawn} of {planes} planes, {skinned} of them with skin, of which {shown} were found drawn"
            );
            let Joins { opened, asked, skinned, running: [middle, longest] } = joins;
            outln!(
                "a page's first hand          {asked:.0} ms after asking for the room, {opened:.0} after opening the page"
            );
            outln!("with its skin                {skinned:.0} ms after asking for the room");
            outln!(
                "in a browser that runs       first hand {middle:.0} ms after asking, {longest:.0} at most of {AGAIN}"
            );
        }
        _ => outln!("encoded to a page drawing it not measured: --chromium FILE"),
    }
}

/// The poses of the built-in clip.
fn demo_poses() -> anyhow::Result<PoseClip> {
    let folder = Scratch::new("live")?;
    let path = folder.0.join("demo.avi");
    demo_clip::write(&path)?;
    let mut source = handcast_media::open(&path, &OpenOptions::default())?;
    let mut options = ClipOptions::default();
    options.smooth = Some(SmoothOptions::live());
    let mut tracker = Tracker::new(options);
    let mut frames = Vec::new();
    while let Some(frame) = source.next_frame()? {
        frames.extend(tracker.push(frame)?);
    }
    frames.extend(tracker.finish()?);
    Ok(PoseClip { header: tracker.header(Some(RATE)), frames })
}

/// The poses as `live` sends them: steadied as they come.
fn steadied(mut clip: PoseClip) -> PoseClip {
    let mut smoothers = [(); 2].map(|()| PoseSmoother::new(SmoothOptions::live()));
    for TimedPose { time, pose, valid, .. } in &mut clip.frames {
        if let Some(steady) = smoothers[pose.side as usize].next(*time, valid.then_some(pose)) {
            *pose = steady;
        }
    }
    clip
}

fn server() -> anyhow::Result<Server> {
    let hour = Duration::from_secs(3600);
    // Readers that only read are not taken for gone.
    let options = ServerOptions::new("127.0.0.1:0".parse()?)
        .with_parts(page::parts(true))
        .with_times(Duration::from_secs(5), hour);
    Ok(Server::start(options)?)
}

/// The poses of a clip, of one instant after the other.
fn instants(clip: &PoseClip) -> Vec<Vec<TimedPose>> {
    let mut out: Vec<Vec<TimedPose>> = Vec::new();
    for frame in &clip.frames {
        match out.last_mut() {
            Some(last) if last.iter().all(|other| (other.time - frame.time).abs() < 1e-6) => {
                last.push(frame.clone());
            }
            _ => out.push(vec![frame.clone()]),
        }
    }
    out
}

/// The poses of an instant of a clip that goes there and back, so that the hand does not leap.
fn there_and_back(instants: &[Vec<TimedPose>], n: usize) -> &[TimedPose] {
    let length = instants.len();
    let at = n % (2 * length).max(1);
    instants.get(if at < length { at } else { 2 * length - 1 - at }).map_or(&[], Vec::as_slice)
}

/// Kilobits a second and hand of payload and on the wire, so many planes a message: of the clip, and of it once the stream has
/// seen what moves how far.
fn wire(clip: &PoseClip, together: usize) -> anyhow::Result<[[f64; 2]; 2]> {
    let server = server()?;
    let mut publisher = server.publisher()?;
    let mut sender = PoseSender::new(LivePoseEncoderOptions::default());
    let instants = instants(clip);
    let mut waiting: Vec<Plane> = Vec::new();
    let mut expected = 0;
    let mut counted = vec![Counted::default()];
    for pass in 0..PASSES {
        for n in pass * instants.len()..(pass + 1) * instants.len() {
            let (seconds, poses) = (n as f64 / RATE, there_and_back(&instants, n));
            let planes = sender.push(seconds, (seconds * 1000.0) as u32, poses, &clip.header)?;
            let rests = planes.is_empty();
            expected += planes.iter().map(|plane| plane.payload.len() as u64).sum::<u64>();
            waiting.extend(planes);
            while waiting.len() >= together || rests && !waiting.is_empty() {
                let many = together.min(waiting.len());
                publisher.planes(&waiting.drain(..many).collect::<Vec<_>>())?;
            }
        }
        publisher.planes(&std::mem::take(&mut waiting))?;
        let patience = Instant::now() + Duration::from_secs(20);
        while server.counted().payload < expected {
            ensure!(Instant::now() < patience, "the room does not take all planes");
            std::thread::sleep(Duration::from_millis(20));
        }
        counted.push(server.counted());
    }
    let seconds = instants.len() as f64 / RATE * clip.header.hands.len().max(1) as f64;
    let rates = |from: usize, to: usize| {
        let told = |of: fn(&Counted) -> u64| (of(&counted[to]) - of(&counted[from])) as f64;
        let kbit = |bytes: f64| bytes * 8.0 / 1000.0 / seconds / (to - from) as f64;
        [kbit(told(|c| c.payload)), kbit(told(|c| c.bytes + c.messages * TCP_IP))]
    };
    Ok([rates(0, 1), rates(SETTLED, PASSES)])
}

/// Sends a clip over and over, so many instants a second, until told to stop.
fn play(
    clip: &PoseClip,
    rate: f64,
    mut publisher: RoomPublisher,
    stop: Arc<AtomicBool>,
) -> std::thread::JoinHandle<anyhow::Result<()>> {
    let (instants, known) = (instants(clip), clip.header.clone());
    std::thread::spawn(move || {
        let mut sender = PoseSender::new(LivePoseEncoderOptions::default());
        let begun = Instant::now();
        for n in 0.. {
            if stop.load(Ordering::Relaxed) {
                break;
            }
            let due = Duration::from_secs_f64(f64::from(n) / rate);
            std::thread::sleep(due.saturating_sub(begun.elapsed()));
            if publisher.wants_intra() {
                sender.request_intra();
            }
            let poses = there_and_back(&instants, n as usize);
            let planes = sender.push(f64::from(n) / RATE, clock_ms(), poses, &known)?;
            if let Some(hello) = sender.take_hello() {
                publisher.hello(&hello)?;
            }
            publisher.planes(&planes)?;
        }
        publisher.end()?;
        Ok(())
    })
}

/// Milliseconds from encoding to a viewer behind a way on which so many segments are lost. No plane may be missing.
fn lossy(clip: &PoseClip, loss: f64, seconds: f64) -> anyhow::Result<Times> {
    let server = server()?;
    let way = lossy_way(server.address(), LossyOptions::default().with_loss(loss))?;
    let mut viewer = RoomClient::connect(way, "hand", "")?;
    let stop = Arc::new(AtomicBool::new(false));
    let player = play(clip, RATE, server.publisher()?, Arc::clone(&stop));
    let (mut times, mut last): (Vec<f64>, Option<Plane>) = (Vec::new(), None);
    let begun = Instant::now();
    while begun.elapsed().as_secs_f64() < seconds {
        let Some(Message::Plane(plane)) = viewer.next(Duration::from_secs(1))? else { continue };
        times.push(f64::from(clock_ms().wrapping_sub(plane.time_ms)));
        if let Some(last) = last.replace(plane.clone()) {
            let next = plane.opens() || (plane.period, plane.index) == (last.period, last.index + 1);
            ensure!(next, "a plane is missing behind {} of period {}", last.index, last.period);
        }
    }
    stop.store(true, Ordering::Relaxed);
    player.join().map_err(|_| anyhow::anyhow!("the sender failed"))??;
    ensure!(!times.is_empty(), "the viewer sees no hand");
    Ok(Times::of(times))
}

/// Milliseconds from connecting to the pose that is to be shown.
fn joins(clip: &PoseClip) -> anyhow::Result<Times> {
    let server = server()?;
    let stop = Arc::new(AtomicBool::new(false));
    let player = play(clip, RATE, server.publisher()?, Arc::clone(&stop));
    std::thread::sleep(Duration::from_secs(1));
    let mut times = Vec::new();
    for _ in 0..40 {
        let begun = Instant::now();
        let mut client = RoomClient::connect(server.address(), "hand", "")?;
        loop {
            match client.next(Duration::from_secs(5))? {
                Some(Message::Plane(plane)) if !plane.replay => break,
                Some(_) => {}
                None => anyhow::bail!("a joiner sees no hand"),
            }
        }
        times.push(begun.elapsed().as_secs_f64() * 1000.0);
        std::thread::sleep(Duration::from_millis(90));
    }
    stop.store(true, Ordering::Relaxed);
    player.join().map_err(|_| anyhow::anyhow!("the sender failed"))??;
    Ok(Times::of(times))
}

/// Readers at once, of planes of a common size.
fn crowd(args: &Args) -> anyhow::Result<Report> {
    let server = server()?;
    let before = resident_mib();
    let mut crowd = Crowd::join(server.address(), "hand", "", args.readers)?;
    let mut publisher = server.publisher()?;
    let sent: SentTimes = Arc::default();
    let planes = (args.seconds * RATE).round() as u32;
    let (times, begun) = (Arc::clone(&sent), Instant::now());
    let sending = std::thread::spawn(move || {
        for number in 0..planes {
            let due = Duration::from_secs_f64(f64::from(number) / RATE);
            std::thread::sleep(due.saturating_sub(begun.elapsed()));
            let index = (number % 150) as u16;
            let mut payload = if index == 0 { vec![0, 0, 1, 0xbb] } else { Vec::new() };
            payload.resize(if index == 0 { 120 } else { 8 }, 0);
            payload.extend(number.to_be_bytes());
            let plane = Plane {
                period: (number / 150) as u16,
                index,
                time_ms: number * 33,
                payload,
                ..Plane::default()
            };
            times.lock().unwrap_or_else(PoisonError::into_inner).push(Instant::now());
            publisher.planes(&[plane])?;
        }
        Ok::<_, handcast_live::transport::TransportError>(publisher)
    });
    let half = begun + Duration::from_secs_f64(args.seconds / 2.0);
    let mut took = crowd.read(&sent, half)?;
    let middle = resident_mib();
    took.extend(crowd.read(&sent, half + Duration::from_secs_f64(args.seconds / 2.0 + 0.5))?);
    let after = resident_mib();
    drop(sending.join().map_err(|_| anyhow::anyhow!("the sender failed"))??);
    let counted = server.counted();
    let cpu = cpu_seconds("live");
    ensure!(counted.deliveries > 0, "nothing was delivered");
    // What the list of measured times itself takes is not the room's.
    let own = took.len() as f64 / 2.0 * 4.0 / f64::from(1 << 20);
    Ok(Report {
        readers: args.readers,
        deliveries: took.len(),
        missed: u64::from(planes) * args.readers as u64 - took.len() as u64,
        delivery_ms: Times::of(took.iter().map(|us| f64::from(*us) / 1000.0).collect()),
        cpu_us_a_delivery: cpu.map(|seconds| seconds * 1e6 / counted.deliveries as f64),
        us_a_delivery: counted.fanout_ns as f64 / 1000.0 / counted.deliveries as f64,
        join_ms: Times::default(),
        kbit_per_s: [[[0.0; 2]; 2]; 3],
        resident_mib: before.zip(middle).zip(after).map(|((a, b), c)| [a, c, c - b - own]),
        lossy_ms: Vec::new(),
        encode_to_drawn_ms: None,
        encode_to_shown_ms: None,
        page_poses: None,
        page_joins_ms: None,
    })
}

/// Memory of this process, where the system tells.
fn resident_mib() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    Some(line.split_whitespace().next()?.parse::<f64>().ok()? / 1024.0)
}

/// Processor time of this process's threads of a name, where the system tells in hundredths of a second.
fn cpu_seconds(name: &str) -> Option<f64> {
    let tasks = std::fs::read_dir("/proc/self/task").ok()?;
    let ticks = tasks.flatten().filter_map(|task| {
        let text = std::fs::read_to_string(task.path().join("stat")).ok()?;
        let (before, fields) = text.rsplit_once(')')?;
        let own = before.split_once('(')?.1 == name;
        let field = |n: usize| fields.split_whitespace().nth(n)?.parse::<u64>().ok();
        own.then(|| Some(field(11)? + field(12)?))?
    });
    Some(ticks.sum::<u64>() as f64 / 100.0)
}

/// From encoding to the picture in a page, and from opening a page to a hand in it, for a report.
fn drawn(clip: &PoseClip, chromium: &Path, script: &Path, report: &mut Report) -> anyhow::Result<()> {
    let server = server()?;
    let stop = Arc::new(AtomicBool::new(false));
    // A little slower, so that planes come at all phases of the screen's pictures.
    let player = play(clip, RATE - 0.13, server.publisher()?, Arc::clone(&stop));
    let folder = Scratch::new("live")?;
    let job = folder.0.join("job.json");
    // Small, since the script has pictures always drawn by the processor.
    let told = serde_json::json!({
        "url": format!("http://{}/hand", server.address()),
        "pages": [{ "width": 420, "height": 420, "hash": "#buffer=0" }],
        "seconds": 15,
        "again": AGAIN,
    });
    std::fs::write(&job, serde_json::to_vec(&told)?)?;
    let output = Command::new("node").arg(script).arg(chromium).arg(&job).output().context("node")?;
    stop.store(true, Ordering::Relaxed);
    player.join().map_err(|_| anyhow::anyhow!("the sender failed"))??;
    ensure!(output.status.success(), "{}: {}", script.display(), String::from_utf8_lossy(&output.stderr));
    let told: serde_json::Value = serde_json::from_slice(&output.stdout)?;
    let drawn = told[0]["drawn"].as_array().context("what was drawn")?;
    // Before the first skin the page loads and compiles.
    let skinned = drawn.iter().filter(|one| one["skinned"] == true);
    let of = |what: &str| -> Vec<f64> { skinned.clone().filter_map(|one| one[what].as_f64()).collect() };
    let (latency, shown) = (of("latency"), of("shown"));
    ensure!(!latency.is_empty() && !shown.is_empty(), "the page has drawn no hand with its skin");
    let ms = |value: &serde_json::Value| value.as_f64().unwrap_or(f64::NAN);
    let state = &told[0]["state"];
    let mut again: Vec<f64> = told[0]["again"].as_array().into_iter().flatten().map(ms).collect();
    again.sort_by(f64::total_cmp);
    let at = |place: usize| again.get(place).copied().unwrap_or(f64::NAN);
    let joins = Joins {
        opened: ms(&told[0]["joined"]),
        asked: ms(&state["joined"]),
        skinned: ms(&state["skinned"]),
        running: [at(AGAIN / 2), at(AGAIN - 1)],
    };
    report.page_poses = Some(PagePoses {
        planes: state["planes"].as_u64().context("planes that came")?,
        drawn: drawn.len(),
        skinned: latency.len(),
        shown: shown.len(),
    });
    report.encode_to_drawn_ms = Some(Times::of(latency));
    report.encode_to_shown_ms = Some(Times::of(shown));
    report.page_joins_ms = Some(joins);
    Ok(())
}
