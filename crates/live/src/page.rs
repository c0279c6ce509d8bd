//! The page of a room: shows the hands of all who send, decoded in the browser, and asks nobody else for anything.

use crate::server::Part;

/// A module: its name without `.js`, and its text.
type Module = (&'static str, &'static str);

const WIRE: Module = ("wire", include_str!("page/wire.js"));
const ROOM: Module = ("room", include_str!("page/room.js"));
const STRIP: Module = ("strip", include_str!("page/strip.js"));
const SHARPNESS: Module = ("sharpness", include_str!("page/sharpness.js"));
const DECODING: Module = ("handcast", handcast_js::SCRIPT);

/// What the page has where those who come may send, and where the room's machine alone does.
const SENDING: [[&str; 2]; 2] = [
    [
        r#"<button id="send" type="button" aria-pressed="false" disabled>"#,
        r#"<button id="send" type="button" aria-pressed="false" disabled hidden>"#,
    ],
    [
        r#"<p id="send-now" class="readout" role="status"></p>"#,
        r#"<p id="send-now" class="readout" role="status">In this room its host alone sends.</p>"#,
    ],
];

/// The page's files: the decoder and the skin as WebAssembly, its scripts, its style. What shows the first hand comes in few
/// files, asked for at once; what sends hands is asked for when somebody sends. Where those who come may not send
/// (`senders`, as in [`ServerOptions::senders`](crate::server::ServerOptions::senders)) the page says so and offers no button.
pub fn parts(senders: bool) -> Vec<Part> {
    const SCRIPT: &str = "text/javascript; charset=utf-8";
    const WASM: &str = "application/wasm";
    let app = [handcast_js::DRAWING, include_str!("page/sketch.js"), include_str!("page/app.js")].concat();
    let style = [handcast_js::STYLE, include_str!("page/live.css")].concat();
    let mut page = include_str!("page/page.html").to_owned();
    if !senders {
        SENDING.iter().for_each(|[offered, told]| page = page.replace(offered, told));
    }
    vec![
        Part::new("", "text/html; charset=utf-8", page),
        Part::new("live.css", "text/css; charset=utf-8", style),
        Part::new("live.js", SCRIPT, joined(&[WIRE, ROOM, STRIP, SHARPNESS, DECODING], &app)),
        Part::new("link.js", SCRIPT, joined(&[WIRE, ROOM], include_str!("page/link.js"))),
        Part::new("handcast_decoder.wasm", WASM, handcast_js::DECODER),
        Part::new("handcast_surface.wasm", WASM, handcast_js::SURFACE),
        Part::new("send.js", SCRIPT, include_str!("page/send.js")),
        Part::new("room.js", SCRIPT, ROOM.1),
        Part::new("wire.js", SCRIPT, WIRE.1),
        Part::new("handcast.js", SCRIPT, DECODING.1),
        Part::new("handcast-sender.js", SCRIPT, handcast_js::SENDER_SCRIPT),
        Part::new("sender-worker.js", SCRIPT, handcast_js::SENDER_WORKER),
        Part::new("handcast_sender.wasm", WASM, handcast_js::SENDER),
    ]
}

/// Modules, in an order in which each stands behind those that it imports, and one that imports them, as one module. Each is a
/// function that gives what it exports.
fn joined(modules: &[Module], main: &str) -> String {
    let mut out = String::new();
    for (name, text) in modules {
        let (mut body, mut exports) = (String::new(), Vec::new());
        for line in text.lines() {
            let line =
                line.strip_prefix("export ").inspect(|rest| exports.extend(exported(rest))).unwrap_or(line);
            body.push_str(&imported(line, modules));
            body.push('\n');
        }
        out.push_str(&format!(
            "const ${name} = (() => {{\n{body}return {{ {} }};\n}})();\n",
            exports.join(", ")
        ));
    }
    for line in main.lines() {
        out.push_str(&imported(line, modules));
        out.push('\n');
    }
    out
}

/// The name that a line tells behind `export`.
fn exported(line: &str) -> Option<&str> {
    let words =
        line.split_whitespace().find(|word| !["const", "class", "async", "function"].contains(word))?;
    words.split(|c: char| !c.is_ascii_alphanumeric() && c != '_').next()
}

/// A line with what it imports of these modules taken from them.
fn imported(line: &str, modules: &[Module]) -> String {
    let told = || {
        let (what, from) = line.strip_prefix("import ")?.strip_suffix(".js\";")?.split_once(" from \"./")?;
        modules.iter().any(|(name, _)| *name == from).then_some((what, from))
    };
    match told() {
        Some((what, from)) => format!("const {} = ${from};", what.trim_start_matches("* as ")),
        None => line.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::server::POLICY;

    #[test]
    fn the_page_has_the_policy_of_its_answer() {
        let page = include_str!("page/page.html");
        assert!(
            page.contains(&format!("<meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">"))
        );
    }

    #[test]
    fn the_page_of_a_host_who_sends_alone_offers_no_button() {
        let page = |senders| {
            let parts = parts(senders);
            String::from_utf8_lossy(&parts[0].bytes).into_owned()
        };
        assert_eq!(page(true), include_str!("page/page.html"));
        for [offered, told] in SENDING {
            assert!(
                page(true).contains(offered) && page(false).contains(told) && !page(false).contains(offered)
            );
        }
    }

    #[test]
    fn what_shows_the_first_hand_is_asked_for_at_once() {
        let parts = parts(true);
        let text = |name: &str| {
            let part = parts.iter().find(|part| part.name == name).unwrap_or_else(|| panic!("{name}"));
            String::from_utf8_lossy(&part.bytes).into_owned()
        };
        // No more than a browser opens connections to a server, and none behind another.
        let asked = ["live.css", "live.js", "link.js", "handcast_decoder.wasm", "handcast_surface.wasm"];
        for name in asked {
            assert!(text("").contains(&format!("=\"{name}\"")), "{name}");
        }
        let imports = |name: &str| {
            let text = text(name);
            let lines = text.lines().filter(|line| line.starts_with("import ") || line.contains("import("));
            lines.map(|line| line.trim().to_owned()).collect::<Vec<_>>()
        };
        assert_eq!(imports("link.js"), [""; 0]);
        let of_page = imports("live.js");
        let own: Vec<_> = of_page.iter().filter(|line| line.contains("\"./")).collect();
        assert_eq!(own.len(), 2, "{own:?}");
        assert!(
            own[0].ends_with("from \"./link.js\";") && own[1].contains("await import(\"./send.js\")"),
            "{own:?}"
        );
    }

    #[test]
    fn joined_modules_give_what_they_export() {
        let a = ("a", "export const x = 1;\nexport async function f() {}\nconst own = 2;");
        let b = ("b", "import * as a from \"./a.js\";\nexport class C extends a.D {}");
        let text = joined(
            &[a, b],
            "import { C } from \"./b.js\";\nimport { z } from \"./z.js\";\nexport const y = 3;",
        );
        let expected = "const $a = (() => {\nconst x = 1;\nasync function f() {}\nconst own = 2;\nreturn { x, f };\n})();\n\
                        const $b = (() => {\nconst a = $a;\nclass C extends a.D {}\nreturn { C };\n})();\n\
                        const { C } = $b;\nimport { z } from \"./z.js\";\nexport const y = 3;\n";
        assert_eq!(text, expected);
    }
}
