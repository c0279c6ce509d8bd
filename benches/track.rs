//! One evaluation of each functional, and the registration of one frame, at 320×240.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, missing_docs)]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use handcast_eval::methods::{FunctionalKind, FunctionalTuning};
use handcast_eval::synth::{ScriptedMotion, Synth, SynthOptions};
use handcast_hand::{FREE_ANGLES, Finger, Morphology, Side};
use handcast_track::{
    Evidence, HandModel, HandTracker, ModelState, NonOverlap, OpenState, Prior, Registration,
    RegistrationOptions, TrackerOptions, Window,
};
use handcast_vision::{Chamfer, Mask};
use std::hint::black_box;

fn open() -> ModelState {
    let mut free = [0.0; FREE_ANGLES];
    for (finger, degrees) in Finger::LONG.into_iter().zip([10.0f64, 0.0, 8.0, 18.0]) {
        free[finger.free_abduction()] = degrees.to_radians();
    }
    ModelState { free, ..ModelState::facing([160.0, 220.0], 1000.0) }
}

fn silhouette(model: &mut HandModel, state: &ModelState) -> Mask {
    let mut mask = Mask::new(320, 240);
    model.draw(state, [0.0, 0.0], &mut mask);
    mask
}

fn bench(c: &mut Criterion) {
    let morphology = Morphology::default();
    let mut model = HandModel::new(&morphology, Side::Right);
    let image = silhouette(&mut model, &open());
    let window = Window::around(&image, None, 0.35).expect("not empty");
    let mut moved = open();
    moved.wrist[0] += 3.0;
    let mut objective = NonOverlap::default();
    c.bench_function("non-overlap rate, whole hand", |b| {
        b.iter(|| objective.rate(&mut model, black_box(&moved), &window));
    });
    objective.hold_rest(&mut model, &moved, Finger::Index, &window);
    c.bench_function("non-overlap rate, one finger", |b| {
        b.iter(|| objective.rate_of_finger(&mut model, black_box(&moved), Finger::Index, &window));
    });
    for (name, kind) in &FunctionalKind::ALL[1..] {
        let mut functional = kind.make(Chamfer::ThreeFour, &FunctionalTuning::default());
        functional.look_at(&window);
        c.bench_function(&format!("{name}, whole hand"), |b| {
            b.iter(|| functional.value(&mut model, black_box(&moved), &window));
        });
        c.bench_function(&format!("{name}, getting ready for a frame"), |b| {
            b.iter(|| functional.look_at(black_box(&window)));
        });
    }
    let rest = OpenState { state: open(), behind: None };
    let mut registration = Registration::new(RegistrationOptions::default());
    let mut evidence = Evidence::default();
    c.bench_function("evidence of a frame", |b| b.iter(|| evidence.load(black_box(&image), None, None, 1)));
    let prior = Prior { predicted: &moved, open: &rest };
    c.bench_function("registration of a frame", |b| {
        b.iter(|| registration.register(&mut model, &evidence, &prior, &mut moved.clone()));
    });
}

/// A tracked frame at sizes of four times the pixels each: from 640 pixels on it is registered on a reduced
/// image, and only reading the silhouette and the picture grows.
fn sizes(c: &mut Criterion) {
    let mut group = c.benchmark_group("tracked frame");
    for size in [(160, 120), (320, 240), (640, 480), (1280, 960)] {
        let mut options = SynthOptions::default();
        (options.motion, options.frames, options.size) = (ScriptedMotion::FlexIndex, 12, size);
        let synth = Synth::new(options).expect("a possible clip");
        let frames: Vec<_> =
            (0..12).map(|i| (synth.silhouette(i), synth.forearm(i), synth.render(i).image)).collect();
        let mut options = TrackerOptions::default();
        options.camera = Some(synth.track_camera());
        let mut tracker = HandTracker::new(&synth.true_fit(&frames[0].0, frames[0].1), options);
        let mut next = frames.iter().cycle();
        group.throughput(Throughput::Elements(u64::from(size.0) * u64::from(size.1)));
        group.bench_function(format!("{}x{}", size.0, size.1), |b| {
            b.iter(|| next.next().map(|(mask, forearm, image)| tracker.track(mask, *forearm, Some(image))));
        });
    }
    group.finish();
}

criterion_group!(benches, bench, sizes);
criterion_main!(benches);
