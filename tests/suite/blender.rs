//! GLB files in Blender's importer, as it is set by default.

use std::path::Path;
use std::process::Command;

use crate::common::command::text;
use crate::common::glb::clip;
use crate::common::python::with_package_on;
use handcast_gltf::{ExportOptions, JointNames, NodeAxes, export};
use handcast_hand::Side;

/// Degrees between a bone and the way to the next joint that nobody minds.
const ALONG: f64 = 5.0;

#[test]
#[ignore = "needs Python 3.11 and its package index: Blender as a package, 373 MB"]
fn bones_lie_along_the_fingers_in_blender() {
    let folder = tempfile::tempdir().unwrap();
    let mut vrm = ExportOptions::default();
    vrm.names = JointNames::Vrm;
    vrm.quantize = true;
    let mut webxr = ExportOptions::default();
    webxr.axes = NodeAxes::WebXr;
    let both = [Side::Left, Side::Right];
    let cases =
        [("left", &both[..1], ExportOptions::default()), ("both", &both, vrm), ("webxr", &both, webxr)];
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/blender.py");
    let mut command = Command::new(with_package_on("python3.11", "bpy", "4.5.4", "bpy"));
    command.arg(script);
    for (name, sides, options) in &cases {
        let file = folder.path().join(format!("{name}.glb"));
        std::fs::write(&file, export(&clip(sides, 40), options).unwrap()).unwrap();
        command.arg(file);
    }
    let out = command.output().expect("python runs");
    assert!(out.status.success(), "{}{}", text(&out.stdout), text(&out.stderr));
    let reports: Vec<serde_json::Value> = text(&out.stdout)
        .lines()
        .filter_map(|line| line.strip_prefix("REPORT "))
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(reports.len(), cases.len());
    for ((name, sides, options), report) in cases.iter().zip(&reports) {
        // Both hands are one armature there.
        assert_eq!(report["armatures"], 1, "{name}");
        // 40 instants at 25 a second, which Blender plays at 24.
        assert_eq!(report["frames"], serde_json::json!([0, 37]), "{name}");
        for when in ["rest", "posed"] {
            let bones = report[when].as_object().unwrap();
            let off: Vec<f64> = bones.values().map(|degrees| degrees.as_f64().unwrap()).collect();
            let worst = off.iter().fold(0.0f64, |worst, &off| worst.max(off));
            let wrong = off.iter().filter(|&&off| off > ALONG).count();
            println!(
                "{name}, {when}: {wrong} of {} bones off by more than {ALONG}°, {worst:.1e}° at most",
                off.len()
            );
            let expected = if options.axes == NodeAxes::WebXr { off.len() } else { 0 };
            assert_eq!((off.len(), wrong), (19 * sides.len(), expected), "{name}, {when}: {bones:?}");
        }
    }
}
