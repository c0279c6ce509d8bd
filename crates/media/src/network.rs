//! Inputs that are addresses of a network.

use std::path::Path;

use super::FrameError;

/// What is at an address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Address {
    /// A file of the web, or a list of files, which comes as fast as it can.
    Web,
    /// Pictures at their own pace, of a camera of the network, say.
    Stream,
}

/// How addresses begin.
const WEB: [&str; 2] = ["http", "https"];
const STREAMS: [&str; 8] = ["rtsp", "rtsps", "rtmp", "rtmps", "rtp", "srt", "tcp", "udp"];

impl Address {
    /// What an input that begins like an address (`SCHEME://…`) is one of; `None` of files.
    ///
    /// # Errors
    /// [`FrameError::Option`] where nothing is read from addresses of its kind; it says from which.
    pub fn of(input: &Path) -> Result<Option<Self>, FrameError> {
        let name = input.to_string_lossy();
        let Some((scheme, _)) = name.split_once("://") else { return Ok(None) };
        let letters = |b: u8| b.is_ascii_alphanumeric() || b"+-.".contains(&b);
        // A single letter is a drive.
        if scheme.len() < 2 || !scheme.bytes().all(letters) {
            return Ok(None);
        }
        let is = |known: &&str| scheme.eq_ignore_ascii_case(known);
        if WEB.iter().any(is) {
            return Ok(Some(Self::Web));
        }
        if STREAMS.iter().any(is) {
            return Ok(Some(Self::Stream));
        }
        let allowed: Vec<String> = WEB.iter().chain(&STREAMS).map(|scheme| format!("{scheme}://")).collect();
        Err(FrameError::Option {
            what: format!(
                "{name}: nothing is read from {scheme}://; allowed are files, and addresses that begin with {}",
                allowed.join(", ")
            ),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_told_from_files() {
        let of = |name: &str| Address::of(Path::new(name));
        assert_eq!(of("http://h/clip.mp4").unwrap(), Some(Address::Web));
        assert_eq!(of("HTTPS://h/a://b").unwrap(), Some(Address::Web));
        for stream in ["rtsp://u:p@cam:554/1", "RTMP://h/live", "udp://@:1234", "srt://h:9"] {
            assert_eq!(of(stream).unwrap(), Some(Address::Stream), "{stream}");
        }
        for file in ["clip.mp4", "C:/clip.mp4", "c://clip.mp4", "a b://c", "shots/*.png", "http:", "://"] {
            assert_eq!(of(file).unwrap(), None, "{file}");
        }
        for other in ["ftp://h/clip.mp4", "file:///etc/passwd", "concat://a"] {
            let said = of(other).unwrap_err().to_string();
            assert!(said.contains(other) && said.contains("http://") && said.contains("rtsp://"), "{said}");
        }
    }
}
