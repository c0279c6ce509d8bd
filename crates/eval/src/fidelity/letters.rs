//! Which letter of American Sign Language a tracker's poses are nearest to, against what is known of a clip.
//!
//! Labels are a text file: a line `FIRST-LAST LETTER` for each range of frames (from 0, the last one included) in which
//! a letter is clearly shown; `#` begins a comment. Postures are compared, among letters whose hand points about where the
//! hand seen does: K and P differ in that alone.

use std::io::BufRead;
use std::path::Path;

use nalgebra::{Point3, Vector3};
use serde::Serialize;

use handcast_hand::shapes::{ShapeError, ShapeLibrary};
use handcast_hand::{HandPose, Joint, JointAngles, Morphology, Side, Skeleton};

use super::counts::{LabelError, parse_ranges, read_labels, share};

/// Frames that show one letter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LetterRange {
    /// The first frame, from 0.
    pub first: usize,
    /// The last frame.
    pub last: usize,
    /// The letter, A to Z.
    pub letter: char,
}

/// The ranges of a clip, in order of time.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LetterLabels(Vec<LetterRange>);

impl LetterLabels {
    /// Reads a file of labels.
    ///
    /// # Errors
    /// See [`LabelError`].
    pub fn read(path: &Path) -> Result<Self, LabelError> {
        read_labels(path, Self::parse)
    }

    /// Reads labels from their text.
    ///
    /// # Errors
    /// Number of the line, from 1, and what is wrong with it.
    pub fn parse(text: impl BufRead) -> Result<Self, (usize, String)> {
        let letter = |word: &str| {
            let mut letters = word.chars();
            let (Some(letter), None) = (letters.next(), letters.next()) else { return None };
            Some(match letter.to_ascii_uppercase() {
                letter @ 'A'..='Z' => Ok(letter),
                _ => Err(format!("{letter:?}, allowed A to Z")),
            })
        };
        let ranges = parse_ranges(text, ("FIRST-LAST LETTER", "58-82 I"), letter)?;
        Ok(Self(
            ranges.into_iter().map(|(first, last, letter)| LetterRange { first, last, letter }).collect(),
        ))
    }

    /// The ranges.
    pub fn ranges(&self) -> &[LetterRange] {
        &self.0
    }

    /// Counts how often `said` (the letter of a frame; `None` where nothing is said of it) is right.
    pub fn score(&self, said: impl Fn(usize) -> Option<char>) -> LetterReport {
        let ranges: Vec<_> = self.0.iter().map(|range| LetterCounts::of(range, &said)).collect();
        let sum = |of: fn(&LetterCounts) -> usize| ranges.iter().map(of).sum();
        let [frames, missed, right] = [sum(|r| r.frames), sum(|r| r.missed), sum(|r| r.right)];
        LetterReport { frames, missed, right, share: share(right, frames), ranges }
    }
}

/// Which letters were said in the ranges of a clip.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LetterReport {
    /// Frames in the ranges.
    pub frames: usize,
    /// Those of which nothing was said: none of them is right.
    pub missed: usize,
    /// Those with the right letter.
    pub right: usize,
    /// Their share, 0 to 1; `None` without frames.
    pub share: Option<f64>,
    /// Range by range.
    pub ranges: Vec<LetterCounts>,
}

/// Which letters were said in one range.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LetterCounts {
    /// The first frame, from 0.
    pub first: usize,
    /// The last frame.
    pub last: usize,
    /// The letter shown.
    pub letter: char,
    /// Frames in it.
    pub frames: usize,
    /// Those of which nothing was said.
    pub missed: usize,
    /// Those with the right letter.
    pub right: usize,
    /// The letters said and how often, most often first.
    pub said: Vec<(char, usize)>,
}

impl LetterCounts {
    fn of(range: &LetterRange, said: impl Fn(usize) -> Option<char>) -> Self {
        let LetterRange { first, last, letter } = *range;
        let mut counts: Vec<(char, usize)> = Vec::new();
        for letter in (first..=last).filter_map(said) {
            match counts.iter_mut().find(|(known, _)| *known == letter) {
                Some((_, count)) => *count += 1,
                None => counts.push((letter, 1)),
            }
        }
        counts.sort_by_key(|&(letter, count)| (std::cmp::Reverse(count), letter));
        let frames = last - first + 1;
        let missed = frames - counts.iter().map(|(_, count)| count).sum::<usize>();
        let right = counts.iter().find(|(known, _)| *known == letter).map_or(0, |(_, count)| *count);
        Self { first, last, letter, frames, missed, right, said: counts }
    }
}

/// Largest angle between where a hand points and where it does in a letter that it may show, radians: a third of a half turn.
const POINTS_ELSEWHERE: f64 = std::f64::consts::FRAC_PI_3;

/// The postures of the letters, for a hand of mean sizes.
#[derive(Clone, Debug)]
pub struct Letters {
    skeleton: Skeleton,
    shapes: Vec<Shape>,
}

#[derive(Clone, Debug)]
struct Shape {
    letter: char,
    /// Where the joints are in the hand frame of a right hand.
    places: [Point3<f64>; Joint::COUNT],
    /// Where the fingers of a left hand and of a right one point when they are stretched, in the camera frame.
    points: [Vector3<f64>; 2],
}

/// Where the fingers of a hand point when they are stretched.
fn points(pose: &HandPose) -> Vector3<f64> {
    pose.rotation * Vector3::y()
}

impl Letters {
    /// Those that come with the program.
    ///
    /// # Errors
    /// [`ShapeError`].
    pub fn builtin() -> Result<Self, ShapeError> {
        let library = ShapeLibrary::builtin()?;
        let skeleton = Skeleton::new(&Morphology::default(), Side::Right);
        let shape = |letter: char| {
            let shape = library.get(&format!("asl:{letter}"))?;
            let points = [Side::Left, Side::Right].map(|side| points(&shape.pose(side)));
            Ok(Shape { letter, places: places(&skeleton, &shape.angles), points })
        };
        let shapes = ('A'..='Z').map(shape).collect::<Result<_, _>>()?;
        Ok(Self { skeleton, shapes })
    }

    /// The letter whose posture is nearest, of those that are shown with a hand that points within 60° of this one, and how
    /// far its joints are, root mean square, metres; of all letters where none is shown so.
    pub fn nearest(&self, pose: &HandPose) -> Option<(char, f64)> {
        let at = places(&self.skeleton, &pose.angles);
        let distance = |shape: &[Point3<f64>; Joint::COUNT]| {
            let squares: f64 = shape.iter().zip(&at).map(|(a, b)| (a - b).norm_squared()).sum();
            (squares / Joint::COUNT as f64).sqrt()
        };
        let like = |shape: &&Shape| shape.points[pose.side as usize].angle(&points(pose)) <= POINTS_ELSEWHERE;
        let nearest = |shapes: &mut dyn Iterator<Item = &Shape>| {
            let letters = shapes.map(|shape| (shape.letter, distance(&shape.places)));
            letters.min_by(|a, b| a.1.total_cmp(&b.1))
        };
        nearest(&mut self.shapes.iter().filter(like)).or_else(|| nearest(&mut self.shapes.iter()))
    }
}

/// Where the joints are in the hand frame of a right hand.
fn places(skeleton: &Skeleton, angles: &JointAngles) -> [Point3<f64>; Joint::COUNT] {
    let frames = skeleton.local_frames(angles);
    Joint::ALL.map(|joint| frames.position(joint))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_and_scored() {
        let labels = LetterLabels::parse(&b"# KI\n0-2 k\n5 I\n"[..]).unwrap();
        assert_eq!(labels.ranges()[0], LetterRange { first: 0, last: 2, letter: 'K' });
        let report = labels.score(|frame| ['K', 'V', 'K', 'A', 'A', 'I'].get(frame).copied());
        assert_eq!((report.frames, report.right, report.share), (4, 3, Some(0.75)));
        assert_eq!(report.ranges[0].said, [('K', 2), ('V', 1)]);
        let none = labels.score(|_| None);
        assert_eq!((none.frames, none.missed, none.share), (4, 4, Some(0.0)));
    }

    #[test]
    fn wrong_lines_are_named() {
        let wrong = |text: &str| LetterLabels::parse(text.as_bytes()).unwrap_err();
        assert_eq!(wrong("1-2 é"), (1, "'é', allowed A to Z".into()));
        assert!(wrong("\n1-2 KK").1.contains("expected FIRST-LAST LETTER such as 58-82 I"));
    }

    #[test]
    fn every_letter_is_nearest_to_itself_or_to_one_of_the_same_posture() {
        let letters = Letters::builtin().unwrap();
        let library = ShapeLibrary::builtin().unwrap();
        for letter in 'A'..='Z' {
            let pose = library.get(&format!("asl:{letter}")).unwrap().pose(Side::Left);
            let (found, distance) = letters.nearest(&pose).unwrap();
            assert!(distance < 1e-12, "{letter} is {distance} m from {found}");
        }
        // Turned upside down K is P.
        for side in [Side::Left, Side::Right] {
            let mut pose = library.get("asl:K").unwrap().pose(side);
            assert_eq!(letters.nearest(&pose).unwrap().0, 'K');
            pose.rotation = library.get("asl:P").unwrap().pose(side).rotation;
            assert_eq!(letters.nearest(&pose).unwrap().0, 'P');
        }
    }
}
