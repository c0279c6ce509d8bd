//! Tells whether the built-in clip is there: the package has none, for its size, and draws it instead.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=fixtures/demo.avi");
    println!("cargo::rustc-check-cfg=cfg(demo_clip)");
    if std::path::Path::new("fixtures/demo.avi").exists() {
        println!("cargo::rustc-cfg=demo_clip");
    }
}
