//! `spec/reports.md` names every key of the JSON that commands print.

use std::collections::BTreeSet;
use std::path::Path;

use crate::common::command::{done, handcast, path, text};
use serde_json::Value;

const SPEC: &str = include_str!("../../spec/reports.md");
const DEMO_POSES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/demo.poses.jsonl");

/// All keys of all objects in a value.
fn keys(value: &Value, found: &mut BTreeSet<String>) {
    match value {
        Value::Object(object) => {
            for (key, value) in object {
                found.insert(key.clone());
                keys(value, found);
            }
        }
        Value::Array(values) => values.iter().for_each(|value| keys(value, found)),
        _ => {}
    }
}

/// Every key of these JSON lines or this JSON text stands in the first column of the section's table.
fn documented(section: &str, json: &str) {
    let body = SPEC.split(&format!("\n## {section}\n")).nth(1).unwrap();
    let body = body.split("\n## ").next().unwrap();
    let rows = body.lines().filter_map(|line| line.strip_prefix("| `")?.split(" | ").next());
    let named: BTreeSet<&str> = rows.flat_map(|row| row.split(['`', ',', ' '])).collect();
    let mut found = BTreeSet::new();
    for value in serde_json::Deserializer::from_str(json).into_iter::<Value>() {
        keys(&value.unwrap(), &mut found);
    }
    let missing: Vec<&String> = found.iter().filter(|key| !named.contains(key.as_str())).collect();
    assert!(!found.is_empty() && missing.is_empty(), "{section}: {missing:?} in no row");
}

#[test]
fn every_key_that_is_printed_is_described() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (clip, stream) = (at("in/clip.avi"), at("hand.fba"));
    std::fs::create_dir(at("in")).unwrap();
    let small = ["--size", "240x180", "--frames", "30", "--motion", "fist", "-q"];
    done(&[&["synth", "-o", path(&clip)][..], &small].concat());

    documented("encode", &done(&["encode", DEMO_POSES, "-o", path(&stream), "--json", "--derive"]));
    documented("inspect", &done(&["inspect", path(&stream), "--json", "--verbose"]));
    let compared = |a: &Path, b: &Path| {
        let out = handcast(&["compare", path(a), path(b), "--json", "--tolerance", "0.1"]);
        documented("compare", &text(&out.stdout));
    };
    done(&["encode", DEMO_POSES, "-o", path(&at("coarse.fba")), "--quant", "20", "-q"]);
    compared(Path::new(DEMO_POSES), &stream);
    compared(&stream, &at("coarse.fba"));
    let (out, demo) = (at("out"), at("demo"));
    let ran = ["run", path(&clip), "-o", path(&out), "--no-pictures", "--smooth", "--json"];
    documented("run", &done(&ran));
    documented("run", &done(&["demo", "-o", path(&demo), "--no-pictures", "--json"]));
    documented("fidelity", &done(&["fidelity", path(&clip), "--json"]));
    documented("fidelity --loss", &done(&["fidelity", DEMO_POSES, "--loss", "5%", "--seeds", "2", "--json"]));

    let person = at("person.toml");
    documented("fit", &done(&["fit", path(&clip), "-o", path(&person), "--json"]));

    std::fs::write(at("in/words.mp4"), "this is no video").unwrap();
    std::fs::write(at("in/notes.txt"), "these are words").unwrap();
    let said = done(&["corpus", path(&at("in")), "-o", path(&at("corpus")), "--json"]);
    documented("corpus", &said);
    let run = &serde_json::from_str::<Value>(&said).unwrap()["run"];
    assert_eq!((&run["others"], &run["other_names"][0]), (&1.into(), &"notes.txt".into()), "{run}");
    assert_eq!(
        (&run["done"], &run["done_clips"], &run["failed"]),
        (&2.into(), &1.into(), &1.into()),
        "{run}"
    );
    documented("corpus", &std::fs::read_to_string(at("corpus/manifest.jsonl")).unwrap());
    documented("corpus", &std::fs::read_to_string(at("corpus/failures.jsonl")).unwrap());
}
