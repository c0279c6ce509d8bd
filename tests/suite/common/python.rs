//! Python with a package from its index.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The interpreter of an environment with this version of a package, made below the target folder, once.
pub fn with_package(package: &str, version: &str, module: &str) -> PathBuf {
    with_package_on("python3", package, version, module)
}

/// As [`with_package`], for packages that only a certain Python takes.
pub fn with_package_on(python3: &str, package: &str, version: &str, module: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{package}-{version}"));
    let python = folder.join("bin/python");
    let works = |python: &Path| {
        let run =
            Command::new(python).args(["-c", &format!("import {module}")]).stderr(Stdio::null()).status();
        run.is_ok_and(|status| status.success())
    };
    if !works(&python) {
        let run = |command: &mut Command| assert!(command.status().unwrap().success(), "{command:?}");
        run(Command::new(python3).args(["-m", "venv", "--clear"]).arg(&folder));
        let wanted = format!("{package}=={version}");
        let install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", &wanted];
        run(Command::new(&python).args(install));
    }
    python
}
