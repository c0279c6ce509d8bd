//! `handcast live`: hands before a camera, sent while they move.

mod address;
mod avatar;
mod capture;
mod passed;
mod record;
mod status;
mod work;

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use handcast_fba::plan::{PlanOptions, Target};
use handcast_hand::smooth::SmoothOptions;
use handcast_live::page;
use handcast_live::sender::{LivePoseEncoderOptions, PoseSender};
use handcast_live::server::{Server, ServerOptions, Tls, check_room, random_token};
use handcast_media::{Address, CameraOptions, ClipInfo, cameras};

use super::common::{ProfileArg, opening};
use super::ending::told_to_stop;
use super::given;
use super::tracking::TrackArgs;
use super::usage::positive;
use avatar::AvatarArgs;
use capture::{Capture, Slot, Source};
use record::{Place, Recording, is_standard_output};
use status::Status;
use work::{Finished, Worker};

/// Sends the hands before a camera while they move, to everybody who opens the address it prints
///
/// The page at that address shows the hands; it needs nothing else. Spread the five fingers once to begin.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Camera (a device, name or number; the first without one), a clip at its own pace, also at an address, rtsp://… and
    /// other streams, or - for Y4M on standard input
    source: Option<PathBuf>,
    /// Name the cameras
    #[arg(long)]
    list: bool,
    /// Name of the room: the page's path
    #[arg(long, value_name = "NAME", default_value = "hand", value_parser = room)]
    room: String,
    /// Where to listen; 0.0.0.0:8747 lets in who is on the same network
    #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:8747", value_parser = listening)]
    bind: SocketAddr,
    /// What who joins must know; none asks for nothing [default: none on this machine, else a random one]
    #[arg(long, value_name = "TOKEN")]
    token: Option<String>,
    /// Name by which the server is called, if not by its address
    #[arg(long, value_name = "NAME", value_parser = host)]
    host: Vec<String>,
    /// Serve by HTTPS: chain of certificates and key, PEM. Other machines' cameras are let in only so
    #[arg(long, num_args = 2, value_names = ["CERT", "KEY"])]
    tls: Option<Vec<PathBuf>>,
    /// Let nobody else send
    #[arg(long)]
    alone: bool,
    /// Record the stream (.fba or .mp4; into a pipe or - as it is); what was recorded when the program is killed is in
    /// NAME.partial.fba
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Width and height asked of the camera, pixels, 16 to 8192 a side
    #[arg(long, value_name = "WxH", default_value = "640x480", value_parser = size)]
    size: [u32; 2],
    /// Pictures per second asked of the camera
    #[arg(long, alias = "fps", value_name = "HZ", default_value_t = 30.0, value_parser = positive)]
    input_fps: f64,
    /// Play a clip over and over
    #[arg(long = "loop")]
    again: bool,
    /// End after so many seconds
    #[arg(long, value_name = "S", value_parser = positive)]
    seconds: Option<f64>,
    /// Root mean square error of the angles ever other than 0, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.5, value_parser = positive)]
    target_rms: f64,
    /// Kilobits per second, in place of an error
    #[arg(long, value_name = "KBPS", conflicts_with = "target_rms", value_parser = positive)]
    bitrate: Option<f64>,
    /// Seconds from one I plane to the next; who misses planes asks for one earlier
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = positive)]
    intra: f64,
    /// Planes in a message, 1 to 4; each more spares headers, and costs up to a frame's time
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=4))]
    together: u8,
    /// Where position and rotation of the hand travel
    #[arg(long, value_enum, default_value_t = ProfileArg::Hand)]
    profile: ProfileArg,
    #[command(flatten)]
    avatar: AvatarArgs,
    #[command(flatten)]
    track: TrackArgs,
}

/// A name of a machine, or its address, without a port; of IPv6 as it stands in URLs.
fn host(text: &str) -> Result<String, String> {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-._".contains(&b);
    let inside = text.strip_prefix('[').and_then(|text| text.strip_suffix(']')).unwrap_or(text);
    if let Ok(address) = inside.parse::<Ipv6Addr>() {
        return Ok(format!("[{address}]"));
    }
    if !text.is_empty() && text.bytes().all(plain) {
        Ok(text.into())
    } else {
        Err("allowed is the name of a machine, or its address, without a port: hands.example.org".into())
    }
}

/// Where to listen: a port, or an address and a port.
fn listening(text: &str) -> Result<SocketAddr, String> {
    let here = |port: &str| port.parse().ok().map(|port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port)));
    let told = text.parse().ok().or_else(|| here(text.strip_prefix("localhost:").unwrap_or(text)));
    told.ok_or_else(|| {
        let port = text.rsplit(':').next().filter(|port| port.parse::<u16>().is_ok()).unwrap_or("8747");
        format!(
            "allowed are an address and a port: 127.0.0.1:{port}, or {port} alone, for this machine; 0.0.0.0:{port} lets in who is on \
             the same network"
        )
    })
}

fn room(text: &str) -> Result<String, String> {
    check_room(text).map(|()| text.into())
}

/// `640x480`.
fn size(text: &str) -> Result<[u32; 2], String> {
    let parsed = text.split_once('x').and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    let allowed = |size: &[u32; 2]| size.iter().all(|side| (16..=8192).contains(side));
    parsed.filter(allowed).ok_or_else(|| "allowed are sizes such as 640x480".into())
}

impl Args {
    /// What poses are coded for.
    fn sender(&self, rate: f64) -> LivePoseEncoderOptions {
        let mode = self.bitrate.map_or(Target::Rms(self.target_rms), Target::Bitrate);
        let usual = LivePoseEncoderOptions::default();
        let plan = PlanOptions { mode, intra_seconds: self.intra, ..usual.plan };
        usual.with_rate(rate).with_plan(plan).with_profile(self.profile.into())
    }

    fn server(&self) -> anyhow::Result<ServerOptions> {
        let token = match self.token.as_deref() {
            Some("none") => String::new(),
            Some(token) => {
                let plain = |b: u8| b.is_ascii_alphanumeric() || b == b'-' || b == b'_';
                if token.is_empty() || !token.bytes().all(plain) {
                    refuse!(
                        "--token: allowed are letters, digits, - and _, at least one; none asks for nothing"
                    );
                }
                token.to_owned()
            }
            None if self.bind.ip().is_loopback() => String::new(),
            None => random_token().context("no random numbers for a token")?,
        };
        let options = ServerOptions::new(self.bind)
            .with_room(&self.room)
            .with_token(token)
            .with_hosts(self.host.clone())
            .with_parts(page::parts(!self.alone))
            .with_senders(!self.alone);
        let Some([certificates, key]) = self.tls.as_deref() else { return Ok(options) };
        let read = |path: &PathBuf| std::fs::read(path).with_context(|| format!("{}", path.display()));
        let tls = Tls::new(&read(certificates)?, &read(key)?);
        let files = || format!("--tls {} {}", certificates.display(), key.display());
        Ok(options.with_tls(tls.map_err(anyhow::Error::msg).with_context(files)?))
    }

    fn records_to_standard_output(&self) -> bool {
        self.record.as_deref().is_some_and(is_standard_output)
    }

    fn source(&self) -> anyhow::Result<Source> {
        let open = opening().with_rate(self.input_fps);
        let camera = CameraOptions::default().with_size(self.size).with_rate(self.input_fps);
        let piped = self.source.as_deref() == Some(Path::new("-"));
        let gone = match self.source.as_deref().map(Address::of).transpose()?.flatten() {
            Some(Address::Stream) => "a stream",
            _ if piped => "what comes by -",
            _ => "",
        };
        if self.again && !gone.is_empty() {
            refuse!("--loop plays a clip over and over; {gone} is gone when it has been seen");
        }
        if piped && !self.track.quiet {
            errln!("waiting for pictures on standard input");
        }
        Source::choose(self.source.as_deref(), &open, &camera, self.again)
    }
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    if args.list {
        let cameras = cameras("ffmpeg".as_ref())?;
        if cameras.is_empty() {
            errln!("no camera is there");
        }
        for camera in cameras {
            outln!("{}\t{}", camera.id, camera.name);
        }
        return Ok(());
    }
    if let Some(option) = given::among(&["mask", "joints"]).first() {
        refuse!("{option} is of one clip: live pictures have none");
    }
    let avatar = args.avatar.connect()?;
    if args.track.json && args.records_to_standard_output() {
        refuse!("--json prints on standard output, where the recording goes: give one of them another place");
    }
    let place = args.record.as_deref().map(|path| Place::of(path, args.track.quiet)).transpose()?;
    let options = args.server()?;
    let (token, secure) = (options.token.clone(), args.tls.is_some());
    let source = args.source()?;
    let info = source.info().clone();
    if source.is_clip() {
        given::note_idle("a clip is no camera", &["size"]);
        given::note_idle_rate("the clip", info.rate, args.input_fps, "input_fps");
    }
    let mut track = args.track.options(None)?;
    // What is sent live cannot wait for fingers to bend.
    track.tuning.contest.undecided = 0;
    // Trembling costs bits, and what follows it at once shows none of it.
    track.smooth = args.track.smooth_or(Some(SmoothOptions::live()));
    // Nor is what was before a hand came of interest.
    track.learn_again = false;
    let server = Server::start(options).map_err(|error| {
        let taken = error.kind() == std::io::ErrorKind::AddrInUse;
        let way = if taken { " (--bind ADDR:PORT names another; port 0 is any that is free)" } else { "" };
        anyhow::Error::from(error).context(format!("cannot serve at {}{way}", args.bind))
    })?;
    let stop = told_to_stop();
    // From here on it ends well, whenever it is told to.
    let recording = place.map(Recording::create).transpose()?;
    address::print(&server, args, &token, secure);

    let slot = Arc::new(Slot::default());
    let capture = Capture::start(source, Arc::clone(&slot), Arc::clone(&stop))?;
    let mut publisher = server.publisher()?;
    let sender = PoseSender::new(args.sender(rate_of(&info)));
    let mut worker = Worker::new(track, sender, usize::from(args.together), recording).with_avatar(avatar);
    let mut status = Status::new(args.track.quiet, args.track.json);
    let begun = Instant::now();
    let over = || args.seconds.is_some_and(|seconds| begun.elapsed().as_secs_f64() >= seconds);
    let mut worked = Ok(());
    // Where nobody sees a hand, nothing else tells that the server has ended.
    while worked.is_ok() && !stop.load(Ordering::Relaxed) && !over() && !server.has_ended() {
        match (slot.is_ended(), slot.take(Duration::from_millis(100))) {
            (_, Some(frame)) => worked = worker.frame(frame, &mut publisher),
            (true, None) => break,
            (false, None) => {}
        }
        status.tell(&mut worker, &slot, &server);
    }
    // Pictures that were ended by a signal say nothing of their source.
    let by_itself = slot.is_ended() && !stop.load(Ordering::Relaxed);
    let moving = if by_itself { more_than_one(&slot, args) } else { Ok(()) };
    stop.store(true, Ordering::Relaxed);
    // Whatever went wrong, all is ended.
    let Finished { recorded, published } = worker.finish(&mut publisher);
    // The last planes are on their way.
    std::thread::sleep(Duration::from_millis(50));
    status.end(&worker, &slot, &server);
    let told = match worker.take_avatar() {
        Some((avatar, seconds)) => avatar.end(seconds, args.track.quiet).map_err(anyhow::Error::from),
        None => Ok(()),
    };
    let stopped = server.stop().context("the room's server ended");
    // That nothing can be published follows from how the server ended.
    let room = stopped.and(worked).and(published);
    first_of([room, capture.end(), moving, recorded, told])
}

/// That what has ended was more than a picture, in which nothing moves.
fn more_than_one(slot: &Slot, args: &Args) -> anyhow::Result<()> {
    let [came, _] = slot.counted();
    if came > 1 {
        return Ok(());
    }
    let name = args.source.as_deref().unwrap_or(Path::new("the camera")).display();
    let what = if came == 1 { "a single picture, in which nothing moves" } else { "there was no picture" };
    bail!("{name}: {what}; live takes a camera, or a clip")
}

/// The first of several errors; those behind it are said on standard error.
fn first_of<const N: usize>(results: [anyhow::Result<()>; N]) -> anyhow::Result<()> {
    let mut errors = results.into_iter().filter_map(Result::err);
    let Some(first) = errors.next() else { return Ok(()) };
    errors.for_each(|error| errln!("handcast: {error:#}"));
    Err(first)
}

/// Frames per second of the stream.
fn rate_of(info: &ClipInfo) -> f64 {
    info.rate.filter(|rate| (1.0..=120.0).contains(rate)).unwrap_or(30.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_alone_is_of_this_machine() {
        for text in ["8749", "localhost:8749", "127.0.0.1:8749"] {
            assert_eq!(listening(text).unwrap().to_string(), "127.0.0.1:8749", "{text}");
        }
        assert_eq!(listening("[::]:8747").unwrap().to_string(), "[::]:8747");
        for text in [":8749", "here:8749"] {
            assert!(listening(text).unwrap_err().contains("0.0.0.0:8749 lets in"), "{text}");
        }
        assert!(listening("65536").unwrap_err().contains("127.0.0.1:8747, or 8747 alone"));
    }

    #[test]
    fn hosts_are_as_urls_have_them() {
        for (text, expected) in [
            ("hands.example.org", "hands.example.org"),
            ("192.168.1.2", "192.168.1.2"),
            ("fd00::1", "[fd00::1]"),
            ("[FD00:0::1]", "[fd00::1]"),
        ] {
            assert_eq!(host(text).unwrap(), expected);
        }
        for text in ["", "[fd00::1", "fd00::1]", "hands.example:443", "[hands]"] {
            assert!(host(text).unwrap_err().contains("without a port"), "{text}");
        }
    }

    #[test]
    fn the_first_error_is_what_it_ends_with() {
        let error = |words: &'static str| Err(anyhow::anyhow!(words));
        assert!(first_of([Ok(()), Ok(())]).is_ok());
        assert_eq!(first_of([Ok(()), error("a"), error("b")]).unwrap_err().to_string(), "a");
    }
}
