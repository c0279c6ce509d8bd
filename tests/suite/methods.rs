//! The paper's methods as frame-to-frame trackers of synthetic sequences.

use handcast_eval::methods::{
    Descent, FrameTracker, Freedom, FunctionalKind, MethodOptions, MethodTracker, OptimiserKind, Order, Seen,
};
use handcast_eval::synth::{ScriptedMotion, Synth, SynthOptions};
use handcast_hand::{Domain, Finger};
use handcast_track::{Fit, ModelState, Window};

fn synth(motion: ScriptedMotion, frames: usize) -> Synth {
    let mut options = SynthOptions::default();
    (options.motion, options.frames, options.size) = (motion, frames, (240, 180));
    Synth::new(options).unwrap()
}

fn fit(synth: &Synth) -> Fit {
    synth.true_fit(&synth.model_silhouette(0), None)
}

fn options(synth: &Synth) -> MethodOptions {
    let mut options = MethodOptions::default();
    options.camera = Some(synth.track_camera());
    options
}

#[test]
fn every_method_follows_a_translation_within_the_constraints() {
    let synth = synth(ScriptedMotion::Translation, 40);
    for (name, optimiser) in OptimiserKind::ALL {
        for (kind, functional) in FunctionalKind::ALL {
            let mut options = options(&synth);
            (options.optimiser, options.functional) = (optimiser, functional);
            (options.freedom, options.order, options.evaluations) = (Freedom::Twelve, Order::Whole, 150);
            let mut tracker = MethodTracker::new(&fit(&synth), options);
            for i in 0..4 {
                let silhouette = synth.model_silhouette(i);
                let found =
                    tracker.next(&Seen { image: None, silhouette: &silhouette, forearm: None }).unwrap();
                assert!(found.valid, "{name} {kind} frame {i}: {}", found.iou);
                assert!(Domain::free().is_feasible(&found.state.free, 1e-9), "{name} {kind}");
                let truth = synth.state(i);
                let apart = (found.state.wrist[0] - truth.wrist[0]).abs();
                assert!(apart < 6.0, "{name} {kind} frame {i}: {apart}");
            }
        }
    }
}

#[test]
fn the_simplex_follows_the_flexion_of_a_finger() {
    let synth = synth(ScriptedMotion::FlexMiddle, 40);
    let mut tracker = MethodTracker::new(&fit(&synth), options(&synth));
    for i in 0..14 {
        let silhouette = synth.model_silhouette(i);
        let found = tracker.next(&Seen { image: None, silhouette: &silhouette, forearm: None }).unwrap();
        let bend =
            |s: &ModelState| s.free[3 * Finger::Middle as usize] + s.free[3 * Finger::Middle as usize + 2];
        let off = (bend(&found.state) - bend(&synth.state(i))).abs().to_degrees();
        assert!(found.iou > 0.95 && off < 25.0, "frame {i}: {off} degrees, {}", found.iou);
    }
}

#[test]
fn a_hand_that_left_is_found_again_elsewhere() {
    let synth = synth(ScriptedMotion::Leave, 30);
    let mut tracker = MethodTracker::new(&fit(&synth), options(&synth));
    let mut lost = 0;
    for i in 0..30 {
        let silhouette = synth.model_silhouette(i);
        let found = tracker.next(&Seen { image: None, silhouette: &silhouette, forearm: None }).unwrap();
        lost += usize::from(!found.valid);
        assert!(!silhouette.is_empty() || !found.valid, "frame {i}");
        if i == 29 {
            assert!(found.iou > 0.95, "{}", found.iou);
        }
    }
    assert!((3..20).contains(&lost), "{lost}");
}

#[test]
fn a_descent_is_traced() {
    let synth = synth(ScriptedMotion::FlexIndex, 40);
    let mut tracker = MethodTracker::new(&fit(&synth), options(&synth));
    let window = Window::around(&synth.model_silhouette(8), None, 0.35).unwrap();
    let Descent { trace, iterations, .. } = tracker.descent(&synth.state(6), &window);
    assert!(iterations > 10);
    assert!(trace.len() > 50 && trace[trace.len() - 1] < trace[0]);
}
