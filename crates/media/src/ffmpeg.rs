//! Video that this crate does not decode, through the `ffmpeg` program as a pipe.

use std::ffi::OsString;
use std::io::{self, BufRead, BufReader};
use std::path::Path;
use std::process::{Child, ChildStderr, Command, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use super::y4m::Y4mSource;
use super::{Address, ClipInfo, Frame, FrameError, FrameSource, OpenOptions, YuvMatrix};

/// How much of the program's messages is kept.
const MAX_MESSAGE: usize = 16 * 1024;

/// Opens `path` with the helper program; `codec` is what makes that necessary.
pub(super) fn open(
    path: &Path,
    name: &str,
    codec: &str,
    options: &OpenOptions,
) -> Result<Box<dyn FrameSource>, FrameError> {
    open_input(&["-i".into(), named(path)], name, codec, FIELDS, options)
}

/// A file as the program takes it for none but a file, whatever its name looks like.
fn named(path: &Path) -> OsString {
    let mut name = OsString::from("file:");
    name.push(path);
    name
}

/// The containers that are looked for in what begins like nothing that is known: those whose files name no other file.
const SELF_CONTAINED: &str = "mov,matroska,avi,mpeg,mpegvideo,mpegts,m4v,h264,hevc,vvc,av1,obu,ivf,flv,live_flv,asf,ogg,nut,\
    mxf,dv,gxf,rm,wtv,roq,bink,swf,nuv,yuv4mpegpipe,mjpeg,gif,apng,jpeg_pipe,png_pipe,webp_pipe,tiff_pipe,psd_pipe,exr_pipe,\
    jpegxl_pipe,jpegxl_anim,j2k_pipe,qoi_pipe,dds_pipe,sunrast_pipe,sgi_pipe,pcx_pipe";

/// Opens `path` with the helper program, which may know better what it is; it is let follow no names in it.
pub(super) fn open_unknown(
    path: &Path,
    name: &str,
    options: &OpenOptions,
) -> Result<Box<dyn FrameSource>, FrameError> {
    let input = ["-format_whitelist".into(), SELF_CONTAINED.into(), "-i".into(), named(path)];
    open_input(&input, name, "unknown container", FIELDS, options)
}

/// What the helper program may ask for what is at an address of the web, and of a stream: never a file of this machine, which
/// a playlist could name.
const WEB_PROTOCOLS: &str = "http,https,httpproxy,tcp,tls,crypto,data";
const STREAM_PROTOCOLS: &str = "rtsp,rtp,srtp,rtmp,rtmps,srt,udp,http,https,httpproxy,tcp,tls,crypto,data";

/// What a stream of the network is called in place of a codec.
const STREAM: &str = "stream";

/// Opens what is at an address with the helper program.
pub(super) fn open_url(
    url: &str,
    address: Address,
    options: &OpenOptions,
) -> Result<Box<dyn FrameSource>, FrameError> {
    let (what, codec, protocols, advice) = match address {
        Address::Web => ("an address of the web", "web", WEB_PROTOCOLS, "download it first"),
        Address::Stream => {
            ("a stream of the network", STREAM, STREAM_PROTOCOLS, "give its pictures as Y4M, by -")
        }
    };
    let unsupported = |hint: &str| FrameError::UnsupportedCodec {
        path: url.to_owned(),
        codec: what.to_owned(),
        hint: hint.to_owned(),
    };
    let mut args = vec!["-protocol_whitelist", protocols];
    if address == Address::Stream {
        // Pictures come when they come, not when there are many of them.
        args.extend(["-fflags", "nobuffer"]);
    }
    args.extend(["-i", url]);
    open_input(&args, url, codec, "", options).map_err(|error| match error {
        FrameError::UnsupportedCodec { .. } if options.ffmpeg.is_some() => {
            unsupported(&format!("; install ffmpeg, or {advice}"))
        }
        FrameError::UnsupportedCodec { .. } => unsupported(&format!("; {advice}")),
        error => error,
    })
}

/// The filter that makes frames of fields; it holds each picture until the next one has come.
const FIELDS: &str = "yadif=deint=interlaced,";

/// The filters that tell the time of each picture among the messages, in microseconds.
const TIMES: &str = "settb=AVTB,metadata=mode=add:key=handcast:value=1,\
    metadata=mode=print:key=handcast:file=pipe\\\\:2:direct=1,";

/// What has each picture written once, of this program and of older ones: Y4M knows even times alone, for which pictures would be
/// repeated and dropped.
const ONCE: [&str; 2] = ["-fps_mode", "-vsync"];
/// What the program says of an option that it does not know.
const UNKNOWN: &str = "Option not found";

/// Opens what the helper program's arguments name: `-i` and what comes before it. Pictures pass `filters` first.
pub(super) fn open_input<S: AsRef<std::ffi::OsStr>>(
    input: &[S],
    name: &str,
    codec: &str,
    filters: &'static str,
    options: &OpenOptions,
) -> Result<Box<dyn FrameSource>, FrameError> {
    Ok(Box::new(open_helper(input, name, codec, filters, options)?))
}

fn open_helper<S: AsRef<std::ffi::OsStr>>(
    input: &[S],
    name: &str,
    codec: &str,
    filters: &'static str,
    options: &OpenOptions,
) -> Result<FfmpegSource, FrameError> {
    let [once, older] = ONCE;
    match open_with(once, input, name, codec, filters, options) {
        Err(FrameError::Helper { message, .. }) if message.contains(UNKNOWN) => {
            open_with(older, input, name, codec, filters, options)
        }
        opened => opened,
    }
}

/// How the program is started again, to begin later.
struct Again {
    input: Vec<OsString>,
    name: String,
    codec: String,
    raw: &'static str,
    options: OpenOptions,
}

/// What the program begins in anywhere, not with a picture that stands alone: those up to the next one would be missing.
const WITHOUT_INDEX: [&str; 6] =
    ["MPEG transport stream", "MPEG program stream", "raw H.264", "unknown container", "web", STREAM];
/// Seconds that are decoded rather than that the program is started again.
const NEAR: f64 = 2.0;
/// Seconds before the first picture that is wanted at which the program begins.
const AHEAD: f64 = 0.1;

/// What pictures pass behind `raw` filters. Y4M has no field for the matrix, so one is asked for; pixels become square, as far
/// as their shape makes sense.
fn filters_behind(raw: &str) -> String {
    let width = "w='if(eq(sar,1)+not(between(sar,0.1,10)),iw,max(1,trunc(iw*sar/2))*2)':h=ih";
    format!("{raw}{TIMES}scale={width}:out_color_matrix=bt709:out_range=limited,setsar=1,format=yuv420p")
}

fn open_with<S: AsRef<std::ffi::OsStr>>(
    once: &str,
    input: &[S],
    name: &str,
    codec: &str,
    raw: &'static str,
    options: &OpenOptions,
) -> Result<FfmpegSource, FrameError> {
    let unsupported = |hint: &str| FrameError::UnsupportedCodec {
        path: name.to_owned(),
        codec: codec.to_owned(),
        hint: hint.to_owned(),
    };
    let Some(program) = &options.ffmpeg else {
        return Err(unsupported("; convert it to H.264 in MP4, or to Y4M, first"));
    };
    let filters = filters_behind(raw);
    let started = Command::new(program)
        .args(["-nostdin", "-v", "error"])
        .args(input)
        .args(["-map", "0:v:0", "-vf", &filters, once, "passthrough"])
        .args(["-f", "yuv4mpegpipe", "-"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let mut child = match started {
        Ok(child) => child,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Err(unsupported("; install ffmpeg, or convert it to H.264 in MP4, or to Y4M, first"));
        }
        Err(error) => {
            return Err(FrameError::Helper {
                path: name.to_owned(),
                program: program.display().to_string(),
                message: error.to_string(),
            });
        }
    };
    let stdout = child.stdout.take();
    let stderr = child.stderr.take();
    let (tell, told) = channel();
    // A full pipe of messages would stop the program, so they are read all the time.
    let messages =
        std::thread::spawn(move || stderr.map_or_else(String::new, |stderr| read_messages(stderr, &tell)));
    let mut helper = Helper {
        child,
        messages: Some(messages),
        said: None,
        path: name.to_owned(),
        program: program.display().to_string(),
    };
    let Some(stdout) = stdout else { return Err(helper.failure(last_said, "it gave no output")) };
    let matrix = YuvMatrix { bt709: true, full_range: false };
    match Y4mSource::open(Box::new(stdout), name, options, Some(matrix)) {
        Ok(mut frames) => {
            let rate = frames.info().rate.unwrap_or(options.rate);
            let times = Times { told, rate, ahead: None, first: None, last: None };
            let times = times.begun();
            let input: Vec<OsString> = input.iter().map(|part| part.as_ref().to_owned()).collect();
            let again = Again {
                input,
                name: name.to_owned(),
                codec: codec.to_owned(),
                raw,
                options: options.clone(),
            };
            frames.set_origin(
                format!("{codec} through ffmpeg"),
                times.first.map_or(0.0, |first| first.max(0.0)),
            );
            Ok(FfmpegSource { frames, times, helper, again, skipped: false, max_side: None })
        }
        Err(FrameError::Empty { .. } | FrameError::Truncated { .. }) => {
            Err(helper.failure(why_no_picture, "it gave no picture"))
        }
        Err(error) => Err(error),
    }
}

/// Sends the times of pictures on, seconds where they are known, and gives the other messages back.
fn read_messages(stderr: ChildStderr, times: &Sender<Option<f64>>) -> String {
    let mut kept = String::new();
    for line in BufReader::new(stderr).split(b'\n').map_while(Result::ok) {
        let line = String::from_utf8_lossy(&line);
        let line = line.trim_end();
        // Behind a message without an end.
        let told = line.split_once("frame:").and_then(|(_, told)| told.split_once(" pts:"));
        if let Some((_, time)) = told.filter(|(number, _)| number.trim().parse::<u64>().is_ok()) {
            let micros = time.split_whitespace().next().and_then(|time| time.parse::<f64>().ok());
            // Nobody may want them any more.
            let _ = times.send(micros.map(|micros| 1e-6 * micros));
        } else if line != "handcast=1" && kept.len() < MAX_MESSAGE {
            kept.push_str(line);
            kept.push('\n');
        }
    }
    kept.trim().to_owned()
}

/// The times of pictures that the program tells before it writes them.
struct Times {
    told: Receiver<Option<f64>>,
    /// Pictures per second.
    rate: f64,
    /// The first picture's, until it is asked for.
    ahead: Option<f64>,
    first: Option<f64>,
    last: Option<f64>,
}

/// How far containers round times, seconds.
const ROUNDED: f64 = 6e-4;
/// How long a time may come after its picture, which it was written before.
const PATIENCE: Duration = Duration::from_secs(1);

impl Times {
    /// Waits for the time of the first picture.
    fn begun(mut self) -> Self {
        self.first = self.told();
        self.ahead = self.first;
        self
    }

    /// What the program tells next.
    fn told(&self) -> Option<f64> {
        self.told.recv_timeout(PATIENCE).ok().flatten().filter(|time: &f64| time.is_finite())
    }

    /// Seconds from the first picture to the next one.
    fn next(&mut self) -> f64 {
        let told = self.ahead.take().or_else(|| self.told());
        let time = told.map(|time| {
            let time = time - *self.first.get_or_insert(time);
            let tick = (time * self.rate).round() / self.rate;
            if (time - tick).abs() < ROUNDED { tick } else { time }
        });
        let follows = |time: &f64| self.last.is_none_or(|last| *time > last);
        let even = || self.last.map_or(0.0, |last| last + self.rate.recip());
        *self.last.insert(time.filter(follows).unwrap_or_else(even))
    }
}

/// The running program; killed when dropped.
struct Helper {
    child: Child,
    messages: Option<JoinHandle<String>>,
    /// What it said though it ended well.
    said: Option<String>,
    path: String,
    program: String,
}

impl Helper {
    /// Ends the program and tells the reason that is in what it said, or `otherwise` if there is none.
    fn failure(&mut self, reason: fn(&str) -> Option<&str>, otherwise: &str) -> FrameError {
        self.stop();
        let said = self.messages.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        FrameError::Helper {
            path: self.path.clone(),
            program: self.program.clone(),
            message: reason(&said).unwrap_or(otherwise).to_owned(),
        }
    }

    /// Keeps what it said of damage that it passed over.
    fn listen(&mut self) {
        let said = self.messages.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        // `[h264 @ 0x5592]`: where it stands in memory is of no interest.
        let plain = |line: &str| match (line.find(" @ 0x"), line.find(']')) {
            (Some(at), Some(end)) if at < end => format!("{}{}", &line[..at], &line[end..]),
            _ => line.to_owned(),
        };
        let first = said.lines().next().map(|line| format!("{} says of it: {}", self.program, plain(line)));
        let further = said.lines().count().saturating_sub(1);
        let more = if further > 0 { format!(" (and {further} more)") } else { String::new() };
        self.said = first.map(|first| first + &more);
    }

    fn stop(&mut self) {
        // Killing a program that has ended already is not a fault.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Helper {
    fn drop(&mut self) {
        self.stop();
    }
}

/// Why the program gave no picture at all, by what it said; none where it said nothing.
fn why_no_picture(said: &str) -> Option<&str> {
    // It has read up to the tables, and cannot go back to the pictures; what it says last does not tell that.
    let ahead = ["partial file", "Stream ends prematurely"].iter().all(|words| said.contains(words));
    if ahead {
        return Some(
            "it could not go back to the pictures: the tables of this MP4 or MOV file are at its end, and the server does \
             not give parts of files (or went away); download the file first, or have its tables at its beginning (ffmpeg \
             -i FILE -c copy -movflags +faststart NEW)",
        );
    }
    last_said(said)
}

/// The last that the program said of what went wrong.
fn last_said(said: &str) -> Option<&str> {
    // What follows an error may be advice on how to call the program.
    said.lines().rfind(|line| !line.is_empty() && !line.starts_with("To ignore this"))
}

struct FfmpegSource {
    frames: Y4mSource,
    times: Times,
    helper: Helper,
    again: Again,
    /// Whether pictures were left out, so that numbers follow from times.
    skipped: bool,
    max_side: Option<u32>,
}

impl FrameSource for FfmpegSource {
    fn info(&self) -> &ClipInfo {
        self.frames.info()
    }

    fn set_max_side(&mut self, side: u32) {
        self.max_side = Some(self.max_side.map_or(side, |own| own.min(side)));
        self.frames.set_max_side(side);
    }

    fn skip_to(&mut self, seconds: f64) -> Result<(), FrameError> {
        let has_index = !WITHOUT_INDEX.contains(&self.again.codec.as_str());
        let (Some(first), true) = (self.times.first, has_index && seconds > NEAR) else { return Ok(()) };
        // As it is told to the program.
        let from = (1e3 * (first + seconds - AHEAD).max(0.0)).floor() / 1e3;
        let mut input: Vec<OsString> = vec!["-ss".into(), format!("{from:.3}").into()];
        input.extend(self.again.input.iter().cloned());
        let Again { name, codec, raw, options, .. } = &self.again;
        // What cannot begin there begins at the beginning.
        let Ok(mut later) = open_helper(&input, name, codec, raw, options) else { return Ok(()) };
        if let Some(side) = self.max_side {
            later.set_max_side(side);
        }
        later.frames.set_origin(self.info().format.clone(), self.info().start);
        // Its times count from where it began.
        later.times.first = Some(first - from);
        later.skipped = true;
        *self = later;
        Ok(())
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        match self.frames.next_frame() {
            Ok(Some(frame)) => {
                let time = self.times.next();
                let index =
                    if self.skipped { (time * self.times.rate).round() as usize } else { frame.index };
                Ok(Some(Frame { index, time, ..frame }))
            }
            Ok(None) => match self.helper.child.wait() {
                Ok(status) if status.success() => {
                    self.helper.listen();
                    Ok(None)
                }
                Ok(status) => Err(self.helper.failure(last_said, &format!("it ended with {status}"))),
                Err(error) => Err(self.helper.failure(last_said, &error.to_string())),
            },
            Err(FrameError::Truncated { .. }) => {
                Err(self.helper.failure(last_said, "its output ends within a picture"))
            }
            other => other,
        }
    }

    fn shortfall(&self) -> Option<String> {
        self.helper.said.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::{last_said, why_no_picture};

    #[test]
    fn reasons_are_what_was_said_last_or_what_it_means() {
        assert_eq!((last_said(""), why_no_picture("")), (None, None));
        assert_eq!(why_no_picture("one\ntwo\nTo ignore this, add a '?'"), Some("two"));
        let said = "[mov,mp4 @ 0x55] stream 0, offset 0x30: partial file\n\
                    [http @ 0x55] Stream ends prematurely at 48, should be 493471\n\
                    Error marking filters as finished";
        let why = why_no_picture(said).unwrap();
        assert!(why.contains("tables") && why.contains("+faststart"), "{why}");
        // Behind pictures it is the server that went away.
        assert_eq!(last_said(said), Some("Error marking filters as finished"));
    }
}
