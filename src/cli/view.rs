//! `handcast view`: the moving hand on a local page.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread::Builder;
use std::time::Duration;

use anyhow::Context;
use handcast_view::{Film, Pictures, Show, Video, bind, page, picture_side, serve, times};

use super::common::{opening, tell_shortfall, told_kind, write_output};
use super::ending::ends_well;
use super::motion::MotionArgs;
use super::usage::positive;

/// Shows the moving hand, its joint angles and its bits on a local page
///
/// Without -o the page is served on 127.0.0.1 until Ctrl-C. Nothing is fetched from anywhere.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Original clip to show beside the hand: any video, folder or pattern of pictures
    #[arg(long, value_name = "CLIP")]
    clip: Option<PathBuf>,
    /// Pictures of the clip in place of its film, their longest side this many pixels, 16 to 1920 [default: the film where browsers play it,
    /// H.264 in MP4; of others pictures of 480, less for long clips]
    #[arg(long, value_name = "PIXELS", requires = "clip", value_parser = clap::value_parser!(u32).range(16..=1920))]
    clip_size: Option<u32>,
    /// Frames per second of a clip that does not say: folders, patterns
    #[arg(long, alias = "clip-rate", value_name = "HZ", requires = "clip", default_value_t = 30.0, value_parser = positive)]
    input_fps: f64,
    /// Write the page to one self-contained file, or to standard output for -
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Tone of the skin, 1 (lightest) to 10 [default: that of the clip where the motion tells it, else 3]
    #[arg(long, value_name = "1-10", value_parser = super::glb_out::tone)]
    tone: Option<u8>,
    /// Port to serve on [default: any that is free]
    #[arg(long, value_name = "N", conflicts_with = "output")]
    port: Option<u16>,
    /// Open the page in the browser
    #[arg(long)]
    open: bool,
    #[command(flatten)]
    motion: MotionArgs,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    if let Some(other) = args.output.as_deref().and_then(|path| told_kind(path, &["html", "htm"])) {
        let output = args.output.as_deref().unwrap_or(Path::new("-")).display();
        refuse!("{output}: a page is no {other} file, allowed are .html and -");
    }
    let input = &args.motion.input;
    let mut motion = args.motion.read()?;
    let told = &mut motion.clip.header.skin_tone;
    *told = args.tone.or(*told);
    let video = match &args.clip {
        Some(clip) => Some(read_clip(clip, args, &times(&motion.clip))?),
        None => None,
    };
    if let Some(note) = video.as_ref().and_then(Video::note) {
        motion.notes.push(note.to_owned());
    }
    for note in &motion.notes {
        errln!("handcast: {}: {note}", input.display());
    }
    let title = input.file_name().map_or_else(|| "poses".into(), |n| n.to_string_lossy());
    let html = page(&Show {
        title: &title,
        clip: &motion.clip,
        morphology: &motion.morphology,
        stream: motion.stream.as_ref(),
        video: video.as_ref(),
        notes: &motion.notes,
    })
    .with_context(|| format!("{}", input.display()))?;
    if let Some(output) = &args.output {
        write_output(output, &html)?;
        if args.open && output.as_os_str() != "-" {
            // A browser that stays in the foreground is not waited for.
            let _ = open(&output.display().to_string()).recv_timeout(OPENING);
        }
        return Ok(());
    }
    let port = args.port.unwrap_or(0);
    let listener = bind(port).map_err(|error| {
        let taken = error.kind() == std::io::ErrorKind::AddrInUse;
        let way = if taken { " (--port names another; without it any that is free is taken)" } else { "" };
        anyhow::Error::from(error).context(format!("cannot serve on port {port} of 127.0.0.1{way}"))
    })?;
    let url = format!("http://{}/", listener.local_addr()?);
    outln!("{url}");
    errln!("Ctrl-C ends it");
    ends_well();
    let _opened = args.open.then(|| open(&url));
    serve(&listener, html).context("the server failed")
}

/// The clip as the page shows it.
fn read_clip(path: &Path, args: &Args, times: &[f64]) -> anyhow::Result<Video> {
    let side = args.clip_size.unwrap_or_else(|| picture_side(times.len()));
    let options = opening().with_rate(args.input_fps).with_max_side(side);
    let mut source = handcast_media::open(path, &options)?;
    let name = || path.display().to_string();
    // A size is asked for of pictures.
    if args.clip_size.is_none()
        && let Some(film) = Film::read(path, &source).with_context(name)?
    {
        return Ok(Video::Film(film));
    }
    let pictures = Pictures::read(&mut source, times, side).with_context(name)?;
    tell_shortfall(path, source.shortfall().as_deref());
    Ok(Video::Pictures(pictures))
}

/// What opens a page on a system: the program, and what comes before the page. A shell would read the page's name.
fn opener(system: &str) -> (&'static str, &'static [&'static str]) {
    match system {
        "macos" => ("open", &[]),
        "windows" => ("rundll32", &["url.dll,FileProtocolHandler"]),
        _ => ("xdg-open", &[]),
    }
}

/// How long what is written to a file waits to hear that no browser has opened it.
const OPENING: Duration = Duration::from_secs(3);

/// Opens a page in the system's browser, beside the work; that there is none is worth a word, not a failure.
fn open(what: &str) -> Receiver<()> {
    let (program, before) = opener(std::env::consts::OS);
    let mut command = Command::new(program);
    command.args(before).arg(what).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let what = what.to_owned();
    let (done, told) = channel();
    let wait = move || {
        match command.status() {
            Ok(status) if !status.success() => {
                errln!("handcast: {program} opens no browser ({status}): open {what} yourself");
            }
            Ok(_) => {}
            Err(error) => errln!("handcast: {program} does not start ({error}): open {what} yourself"),
        }
        // Nobody may wait for it any more.
        let _ = done.send(());
    };
    // Without a thread the page is there to be opened all the same.
    let _ = Builder::new().name("browser".into()).spawn(wait);
    told
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_shell_reads_what_is_opened() {
        for system in ["linux", "macos", "windows"] {
            assert!(!["cmd", "sh", "powershell"].contains(&opener(system).0), "{system}");
        }
    }
}
