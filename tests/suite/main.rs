//! What the program and the packages behind it do together, in one binary: linked once, its tests side by side.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

mod bench_track;
mod blender;
mod cli;
mod conformance;
mod corpus;
mod damaged;
mod doors;
mod examples;
mod exports;
mod fba_cli;
mod fba_loss;
mod fba_minimal;
mod fba_rate;
mod fidelity;
mod films;
mod fit;
mod frames;
mod fuzz_corpus;
mod gltf;
mod hand_model;
mod hold;
mod imports;
mod labels;
mod landmarks;
mod live;
mod live_rooms;
mod methods;
mod names;
mod net;
mod parts;
mod pipes;
mod push;
mod reports;
mod retarget;
mod send;
mod sighted;
mod stream_files;
mod structure;
mod synth;
mod three;
mod track;
mod view;
mod vision_made;
mod vision_real;
mod vrma;
mod web;
mod wrong_inputs;
