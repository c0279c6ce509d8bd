//! From one picture of the open hand to the person's sizes.

use std::time::Duration;

use image::{GrayImage, RgbImage};
use thiserror::Error;

use super::clock::Instant;
use super::{ANALYSIS_SIDE, StartTuning, open_hand};
use crate::{Fit, FitOptions, Forearm, PinholeCamera, View, fit_open_hand};
use handcast_hand::Side;
use handcast_vision::{
    HandParts, Mask, PartsError, SegmentOptions, Segmenter, Silhouette, TopHat, VisionError, parts_of,
    shrunk, top_hat,
};

/// How a picture is fitted.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct StillOptions {
    /// Left or right hand, when it is known.
    pub side: Option<Side>,
    /// Palm or back, when it is known.
    pub view: Option<View>,
    /// Wrist to middle fingertip, metres.
    pub hand_length: f64,
    /// Angle that the longer side of the picture sees, degrees.
    pub field_of_view: f64,
    /// A ready silhouette, white is hand: takes the place of segmentation.
    pub mask: Option<GrayImage>,
    /// A piece of skin, from which its colours are learnt; without, from the picture alone.
    pub sample: Option<RgbImage>,
    /// Segmentation.
    pub segment: SegmentOptions,
}

impl Default for StillOptions {
    fn default() -> Self {
        Self {
            side: None,
            view: None,
            hand_length: FitOptions::default().hand_length,
            field_of_view: 60.0,
            mask: None,
            sample: None,
            segment: SegmentOptions::default().with_max_side(ANALYSIS_SIDE),
        }
    }
}

/// Why a picture gives no person.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum StillError {
    /// There is no silhouette of one hand.
    #[error(transparent)]
    Vision(#[from] VisionError),
    /// The hand is not open.
    #[error(transparent)]
    Parts(#[from] PartsError),
    /// The ready silhouette belongs to another picture.
    #[error("the mask has another shape than the picture: {} x {} and {} x {} pixels when scaled alike", mask.0, mask.1, picture.0, picture.1)]
    MaskSize {
        /// Width and height of the mask at the analysis size.
        mask: (u32, u32),
        /// Width and height of the picture at the analysis size.
        picture: (u32, u32),
    },
    /// What was said of the hand contradicts its thumb.
    #[error(
        "the {} of a {} hand has its thumb on the {}; here it is clearly on the other side",
        if *view == View::Palm { "palm" } else { "back" }, side.name(),
        if View::of(*side, true) == *view { "right" } else { "left" }
    )]
    Contradiction {
        /// The hand that was named.
        side: Side,
        /// The view that was named.
        view: View,
    },
    /// The model does not come to lie on the silhouette.
    #[error("the model fits the hand badly: overlap {iou:.2}, at least {least:.2} is needed")]
    BadFit {
        /// Intersection over union.
        iou: f64,
        /// What was asked for.
        least: f64,
    },
}

/// Time spent in each stage.
#[derive(Clone, Copy, Debug, Default)]
pub struct StillTimings {
    /// Learning the colours.
    pub learn: Duration,
    /// The silhouette, cut at the wrist.
    pub segment: Duration,
    /// Fingers, palm and wrist.
    pub parts: Duration,
    /// The fit of the model.
    pub fit: Duration,
}

impl StillTimings {
    /// All stages.
    pub fn total(&self) -> Duration {
        self.learn + self.segment + self.parts + self.fit
    }
}

/// What the model says of the hand in the picture.
#[derive(Clone, Debug)]
pub struct StillFit {
    /// Sizes, side, place in the image.
    pub fit: Fit,
    /// Palm or back.
    pub view: View,
    /// Whether palm or back was assumed: a silhouette cannot tell a right palm from a left back.
    pub assumed: bool,
    /// The camera, at the analysis size.
    pub camera: PinholeCamera,
}

/// All that was found on the way: the stages up to the last, or up to the one that failed.
#[derive(Clone, Debug, Default)]
pub struct Stages {
    /// The picture at the analysis size.
    pub image: RgbImage,
    /// How much each pixel looks like skin; not with a ready silhouette.
    pub likelihood: Option<GrayImage>,
    /// What looks more like skin than not; not with a ready silhouette.
    pub raw: Option<Mask>,
    /// The outline, and where the forearm was cut from the hand.
    pub silhouette: Option<Silhouette>,
    /// What may be fingers.
    pub top_hat: Option<TopHat>,
    /// Fingers, palm, axes and wrist.
    pub parts: Option<HandParts>,
    /// The fitted model, also a bad one.
    pub fit: Option<StillFit>,
    /// Time spent.
    pub timings: StillTimings,
}

/// Fits the hand model to the open hand in `image`; `stages` receives what is found on the way.
///
/// # Errors
/// [`StillError`] says which stage failed and why; `stages` then holds those before it.
pub fn fit_still(
    image: &RgbImage,
    options: &StillOptions,
    stages: &mut Stages,
) -> Result<StillFit, StillError> {
    *stages = Stages::default();
    let silhouette = silhouette(image, options, stages)?;
    stages.silhouette = Some(silhouette.clone());

    let begun = Instant::now();
    let parts = parts(&silhouette, options, stages);
    stages.timings.parts = begun.elapsed();
    let parts = parts?;
    let open = open_hand(&parts);
    stages.parts = Some(parts);
    let (side, view, assumed) = View::settle(options.side, options.view, open.thumb_right());
    if options.view.is_some_and(|told| told != view) {
        return Err(StillError::Contradiction { side, view: options.view.unwrap_or(view) });
    }

    let begun = Instant::now();
    let hand = &silhouette.hand;
    let camera = PinholeCamera::with_field_of_view(hand.width(), hand.height(), options.field_of_view);
    let mut fit_options = FitOptions { hand_length: options.hand_length, ..FitOptions::default() };
    fit_options.camera = Some(camera);
    let forearm = silhouette.wrist.as_ref().map(Forearm::from);
    let fit = fit_open_hand(hand, forearm, &open, side, view, &fit_options);
    stages.timings.fit = begun.elapsed();
    let least = StartTuning::default().least_fit;
    let fit = fit.ok_or(StillError::BadFit { iou: 0.0, least })?;
    let iou = fit.iou;
    let found = StillFit { fit, view, assumed, camera };
    stages.fit = Some(found.clone());
    if iou < least {
        return Err(StillError::BadFit { iou, least });
    }
    Ok(found)
}

fn silhouette(
    image: &RgbImage,
    options: &StillOptions,
    stages: &mut Stages,
) -> Result<Silhouette, StillError> {
    let begun = Instant::now();
    stages.image = shrunk(image, options.segment.max_side);
    let image = &stages.image;
    let timings = &mut stages.timings;
    if let Some(mask) = &options.mask {
        let silhouette = Silhouette::from_gray(mask, &options.segment)?;
        let mask = (silhouette.hand.width(), silhouette.hand.height());
        if mask != image.dimensions() {
            return Err(StillError::MaskSize { mask, picture: image.dimensions() });
        }
        timings.segment = begun.elapsed();
        return Ok(silhouette);
    }
    let samples = std::slice::from_ref(image);
    let mut segmenter = match &options.sample {
        Some(skin) => Segmenter::learn_from(skin, samples, options.segment)?,
        None => Segmenter::learn(samples, options.segment)?,
    };
    timings.learn = begun.elapsed();
    let begun = Instant::now();
    let silhouette = segmenter.segment(image);
    timings.segment = begun.elapsed();
    stages.likelihood = Some(segmenter.posterior());
    stages.raw = Some(segmenter.skin_mask());
    Ok(silhouette?)
}

fn parts(
    silhouette: &Silhouette,
    options: &StillOptions,
    stages: &mut Stages,
) -> Result<HandParts, PartsError> {
    let top_hat = top_hat(silhouette, &options.segment.parts)?;
    let thumb = View::told_thumb(options.side, options.view);
    let parts = parts_of(silhouette, &top_hat, thumb, &options.segment.parts);
    stages.top_hat = Some(top_hat);
    parts
}
