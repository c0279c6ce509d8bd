//! Numbered pictures in a folder or matching a pattern.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use super::{ClipInfo, Frame, FrameError, FrameSource, OpenOptions, animation, check_size, first_video};
use handcast_limits::Limits;
use handcast_picture::Shrinker;

/// Most pictures taken from one folder.
const MAX_FILES: usize = 1_000_000;
const EXTENSIONS: [&str; 9] = ["png", "jpg", "jpeg", "webp", "bmp", "ppm", "pgm", "pnm", "gif"];

/// Pictures in the natural order of their names, at a given rate.
pub(super) struct FolderSource {
    files: Vec<PathBuf>,
    info: ClipInfo,
    rate: f64,
    shrinker: Shrinker,
    limits: Limits,
    index: usize,
    /// How many pictures could not be read, and what is wrong with the first of them.
    lost: usize,
    damage: Option<FrameError>,
}

impl FolderSource {
    /// All pictures directly in `folder`, told by their extension.
    pub(super) fn from_folder(folder: &Path, options: &OpenOptions) -> Result<Self, FrameError> {
        let name = folder.display().to_string();
        let io = |source| FrameError::Io { path: name.clone(), source };
        let (mut files, mut others) = (Vec::new(), Vec::new());
        for entry in std::fs::read_dir(folder).map_err(io)? {
            let path = entry.map_err(io)?.path();
            let hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
            let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
            if !hidden && extension.is_some_and(|e| EXTENSIONS.contains(&e.as_str())) && path.is_file() {
                files.push(path);
            } else if !hidden {
                others.push(path);
            }
        }
        if files.is_empty() {
            return Err(match first_video(others) {
                Some(first) => FrameError::Clips { path: name, first },
                None => FrameError::Empty { path: name, what: "the folder holds no picture" },
            });
        }
        Self::from_files(files, &name, "folder", options)
    }

    /// All files matching a shell pattern.
    #[cfg(feature = "pictures")]
    pub(super) fn from_pattern(pattern: &str, options: &OpenOptions) -> Result<Self, FrameError> {
        let malformed = |what: String| FrameError::Malformed { path: pattern.to_owned(), what };
        let paths = glob::glob(pattern).map_err(|error| malformed(format!("pattern: {error}")))?;
        let mut files = Vec::new();
        for path in paths {
            let path = path.map_err(|error| malformed(error.to_string()))?;
            if path.is_file() {
                files.push(path);
            }
        }
        if files.is_empty() {
            return Err(FrameError::NotFound { path: pattern.to_owned() });
        }
        Self::from_files(files, pattern, "pattern", options)
    }

    /// All numbered pictures that a pattern in ffmpeg's style names: `shot%03d.png`, with any first number.
    pub(super) fn from_numbered(pattern: &Path, options: &OpenOptions) -> Result<Self, FrameError> {
        let name = pattern.display().to_string();
        let missing = || FrameError::NotFound { path: name.clone() };
        let file = pattern.file_name().and_then(|file| file.to_str()).ok_or_else(missing)?;
        let numbered = Numbered::of(file).ok_or_else(missing)?;
        let folder = pattern.parent().filter(|folder| !folder.as_os_str().is_empty());
        let entries = std::fs::read_dir(folder.unwrap_or(Path::new("."))).map_err(|_| missing())?;
        let mut files = Vec::new();
        for entry in entries {
            let entry = entry.map_err(|source| FrameError::Io { path: name.clone(), source })?;
            let fits = entry.file_name().to_str().is_some_and(|file| numbered.fits(file));
            let path =
                folder.map_or_else(|| entry.file_name().into(), |folder| folder.join(entry.file_name()));
            if fits && path.is_file() {
                files.push(path);
            }
        }
        if files.is_empty() {
            return Err(missing());
        }
        Self::from_files(files, &name, "pattern", options)
    }

    fn from_files(
        mut files: Vec<PathBuf>,
        name: &str,
        kind: &str,
        options: &OpenOptions,
    ) -> Result<Self, FrameError> {
        if files.len() > MAX_FILES {
            let what = format!("{} pictures; allowed are {MAX_FILES}", files.len());
            return Err(FrameError::Malformed { path: name.to_owned(), what });
        }
        files.sort_by(|a, b| natural(&a.to_string_lossy(), &b.to_string_lossy()));
        let sizes = files.iter().map(|file| animation::dimensions(file, &options.limits));
        let size = match first_good(sizes).unwrap_or(Ok((0, 0))) {
            Err(error @ FrameError::NotAVideo { .. }) => Err(match first_video(files.clone()) {
                Some(first) => FrameError::Clips { path: name.to_owned(), first },
                None => error,
            }),
            size => size,
        };
        let (width, height) = size?;
        let (width, height) = check_size(name, u64::from(width), u64::from(height), &options.limits)?;
        let info = ClipInfo {
            width,
            height,
            rate: Some(options.rate),
            frames: Some(files.len()),
            format: format!("{kind} of {} pictures", files.len()),
            notes: missing(&files).into_iter().collect(),
            ..ClipInfo::default()
        };
        Ok(Self {
            files,
            info,
            rate: options.rate,
            shrinker: Shrinker::new(options.max_side),
            limits: options.limits.clone(),
            index: 0,
            lost: 0,
            damage: None,
        })
    }
}

impl FrameSource for FolderSource {
    fn info(&self) -> &ClipInfo {
        &self.info
    }

    fn set_max_side(&mut self, side: u32) {
        self.shrinker.limit(side);
    }

    fn times(&self) -> Option<Vec<f64>> {
        Some((0..self.files.len()).map(|index| index as f64 / self.rate).collect())
    }

    fn skip_to(&mut self, seconds: f64) -> Result<(), FrameError> {
        self.index = ((seconds * self.rate) as usize).saturating_sub(1).min(self.files.len());
        Ok(())
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        while let Some(path) = self.files.get(self.index) {
            let index = self.index;
            self.index += 1;
            let first = (self.info.width, self.info.height);
            match animation::read_picture(path, &self.limits) {
                Ok(image) if image.dimensions() == first => {
                    let image = self.shrinker.rgb(image);
                    return Ok(Some(Frame { index, time: index as f64 / self.rate, image }));
                }
                Ok(image) => {
                    let (path, size) = (path.display().to_string(), image.dimensions());
                    return Err(FrameError::OtherSize { path, size, first });
                }
                Err(error) if is_damage(&error) => {
                    self.lost += 1;
                    self.damage.get_or_insert(error);
                }
                Err(error) => return Err(error),
            }
        }
        // Where there was none at all what is wrong with the first is.
        match self.damage.take_if(|_| self.lost == self.files.len()) {
            Some(error) => Err(error),
            None => Ok(None),
        }
    }

    fn shortfall(&self) -> Option<String> {
        let more = if self.lost > 1 { format!(" (and {} more)", self.lost - 1) } else { String::new() };
        self.damage.as_ref().map(|error| format!("{error}{more}"))
    }
}

/// The parts of a name with a number: `%d`, or `%03d` of three digits or more. `%%` stands for a percent sign.
struct Numbered {
    before: String,
    digits: usize,
    after: String,
}

impl Numbered {
    /// `None` where the pattern has no number, or several.
    fn of(pattern: &str) -> Option<Self> {
        let (mut found, mut text, mut rest) = (None, String::new(), pattern);
        while let Some((plain, behind)) = rest.split_once('%') {
            text.push_str(plain);
            rest = match behind.strip_prefix('%') {
                Some(behind) => {
                    text.push('%');
                    behind
                }
                None => {
                    let (digits, behind) = behind.split_once('d')?;
                    let digits =
                        if digits.is_empty() { 1 } else { digits.strip_prefix('0')?.parse().ok()? };
                    if found.replace((std::mem::take(&mut text), digits)).is_some() {
                        return None;
                    }
                    behind
                }
            };
        }
        let (before, digits) = found?;
        Some(Self { before, digits, after: text + rest })
    }

    fn fits(&self, name: &str) -> bool {
        let number = name.strip_prefix(&self.before).and_then(|rest| rest.strip_suffix(&self.after));
        number.is_some_and(|number| {
            let is_filled =
                number.len() == self.digits || number.len() > self.digits && !number.starts_with('0');
            is_filled && number.bytes().all(|byte| byte.is_ascii_digit())
        })
    }
}

/// Whether it is the picture that is wrong.
fn is_damage(error: &FrameError) -> bool {
    error.damage().is_some() || matches!(error, FrameError::NotAVideo { .. })
}

/// The first size of a picture that is not damaged, or the first error.
fn first_good(
    sizes: impl Iterator<Item = Result<(u32, u32), FrameError>>,
) -> Option<Result<(u32, u32), FrameError>> {
    let mut wrong = None;
    for size in sizes {
        match size {
            Err(error) if is_damage(&error) => {
                wrong.get_or_insert(Err(error));
            }
            size => return Some(size),
        }
    }
    wrong
}

/// What is to be said of files numbered in even steps of which some are missing.
fn missing(files: &[PathBuf]) -> Option<String> {
    let numbers: Vec<u64> = files.iter().map(|path| number_of(path)).collect::<Option<_>>()?;
    let steps: Vec<u64> =
        numbers.windows(2).map(|pair| pair[1].checked_sub(pair[0])).collect::<Option<_>>()?;
    let step = steps.iter().copied().min().filter(|step| *step > 0)?;
    if steps.iter().any(|other| other % step != 0) {
        return None;
    }
    let missing: u64 = steps.iter().map(|other| other / step - 1).sum();
    let before = files.get(steps.iter().position(|other| *other > step)?)?.file_name()?.to_string_lossy();
    let [are, they] = if missing == 1 { ["number is", "it"] } else { ["numbers are", "they"] };
    Some(format!(
        "{missing} {are} missing, the first behind {before}: the pictures follow each other as if {they} had never been"
    ))
}

/// The number that a name ends with.
fn number_of(path: &Path) -> Option<u64> {
    let stem = path.file_stem()?.to_str()?;
    let before = stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    stem.get(before..)?.parse().ok()
}

/// Orders runs of digits by their value, everything else by character: `a2` before `a10`.
fn natural(a: &str, b: &str) -> Ordering {
    let (mut a, mut b) = (a, b);
    loop {
        let digits = |s: &str| s.len() - s.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        match (digits(a), digits(b)) {
            (0, _) | (_, 0) => {
                let (mut ca, mut cb) = (a.chars(), b.chars());
                match (ca.next(), cb.next()) {
                    (None, None) => return Ordering::Equal,
                    (x, y) if x != y => return x.cmp(&y),
                    _ => (a, b) = (ca.as_str(), cb.as_str()),
                }
            }
            (m, n) => {
                let (x, y) = (a[..m].trim_start_matches('0'), b[..n].trim_start_matches('0'));
                // Of equal values the one with fewer leading zeros comes first.
                let order = x.len().cmp(&y.len()).then_with(|| x.cmp(y)).then(m.cmp(&n));
                if order != Ordering::Equal {
                    return order;
                }
                (a, b) = (&a[m..], &b[n..]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_numbers_are_told() {
        let told = |numbers: &[u64]| {
            let files: Vec<PathBuf> = numbers.iter().map(|n| format!("a/f{n:04}.png").into()).collect();
            missing(&files)
        };
        for whole in [&[3][..], &[1, 2, 3, 4], &[0, 5, 10, 15], &[1, 3, 8, 10], &[4, 4]] {
            assert_eq!(told(whole), None, "{whole:?}");
        }
        let text = told(&[1, 2, 3, 6, 7, 9]).unwrap();
        assert!(text.starts_with("3 numbers are missing, the first behind f0003.png"), "{text}");
        let text = told(&[10, 20, 40]).unwrap();
        assert!(text.starts_with("1 number is missing, the first behind f0020.png"), "{text}");
    }

    #[test]
    fn clips_in_place_of_pictures_are_named() {
        let folder = std::env::temp_dir().join(format!("handcast-clips-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        for (name, content) in
            [("b.avi", &b"RIFF\x10\0\0\0AVI LIST"[..]), ("c.mp4", b"words"), ("a.txt", b"words")]
        {
            std::fs::write(folder.join(name), content).unwrap();
        }
        let told = |name: &str| crate::open(folder.join(name), &OpenOptions::default()).err().unwrap();
        let clips = |name: &str| match told(name) {
            FrameError::Clips { first, .. } => first.ends_with("b.avi"),
            _ => false,
        };
        assert!(clips(""), "{:?}", told(""));
        #[cfg(feature = "pictures")]
        assert!(clips("*.avi") && clips("*"), "{:?}", told("*.avi"));
        #[cfg(feature = "pictures")]
        assert!(matches!(told("*.mp4"), FrameError::NotAVideo { .. }));
        std::fs::remove_file(folder.join("b.avi")).unwrap();
        assert!(matches!(told(""), FrameError::Empty { .. }));
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[cfg(feature = "pictures")]
    #[test]
    fn whatever_the_system_says_of_a_pattern_it_is_one() {
        let folder = std::env::temp_dir().join(format!("handcast-pattern-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        for n in 0..3 {
            image::RgbImage::new(32, 32).save(folder.join(format!("p{n}.png"))).unwrap();
        }
        let open = |name: &str| crate::open(folder.join(name), &OpenOptions::default());
        assert_eq!(open("p*.png").unwrap().info().frames, Some(3));
        // Below a file there is none: another error than that of a missing one.
        let error = open("p0.png/*.png").err().unwrap();
        assert!(matches!(error, FrameError::NotFound { .. }), "{error:?}");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn numbers_are_written_as_patterns_say() {
        let fits = |pattern: &str, name: &str| Numbered::of(pattern).unwrap().fits(name);
        assert!(fits("a%03d.png", "a007.png") && fits("a%03d.png", "a1234.png"));
        assert!(fits("%d.png", "12.png") && fits("%d.png", "0.png") && fits("100%%-%02d.png", "100%-07.png"));
        for (pattern, name) in [
            ("a%03d.png", "a7.png"),
            ("a%03d.png", "a0007.png"),
            ("a%d.png", "a07.png"),
            ("a%d.png", "a.png"),
            ("a%d.png", "a-1.png"),
            ("a%d.png", "b1.png"),
        ] {
            assert!(!fits(pattern, name), "{pattern} {name}");
        }
        for pattern in ["a.png", "a%s.png", "a%3d.png", "%d-%d.png", "a%"] {
            assert!(Numbered::of(pattern).is_none(), "{pattern}");
        }
    }

    #[test]
    fn numbers_order_by_value() {
        let mut names = ["f10.png", "f9.png", "f1.png", "f09.png", "e99.png", "f.png", "f1b.png"];
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(names, ["e99.png", "f.png", "f1.png", "f1b.png", "f9.png", "f09.png", "f10.png"]);
    }
}
