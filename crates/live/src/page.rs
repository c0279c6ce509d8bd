//! The page of a room: shows the hands of all who send, decoded in the browser, and asks nobody else for anything.

use crate::server::Part;

/// The page's files: the decoder and the skin as WebAssembly, its scripts, its style.
pub fn parts() -> Vec<Part> {
    const SCRIPT: &str = "text/javascript; charset=utf-8";
    const WASM: &str = "application/wasm";
    let app = [handcast_js::DRAWING, include_str!("page/sketch.js"), include_str!("page/app.js")].concat();
    let style = [handcast_js::STYLE, include_str!("page/live.css")].concat();
    vec![
        Part::new("", "text/html; charset=utf-8", include_str!("page/page.html")),
        Part::new("live.css", "text/css; charset=utf-8", style),
        Part::new("live.js", SCRIPT, app),
        Part::new("link.js", SCRIPT, include_str!("page/link.js")),
        Part::new("room.js", SCRIPT, include_str!("page/room.js")),
        Part::new("send.js", SCRIPT, include_str!("page/send.js")),
        Part::new("strip.js", SCRIPT, include_str!("page/strip.js")),
        Part::new("wire.js", SCRIPT, include_str!("page/wire.js")),
        Part::new("handcast.js", SCRIPT, handcast_js::SCRIPT),
        Part::new("handcast-sender.js", SCRIPT, handcast_js::SENDER_SCRIPT),
        Part::new("sender-worker.js", SCRIPT, handcast_js::SENDER_WORKER),
        Part::new("handcast_sender.wasm", WASM, handcast_js::SENDER),
        Part::new("handcast_decoder.wasm", WASM, handcast_js::DECODER),
        Part::new("handcast_surface.wasm", WASM, handcast_js::SURFACE),
    ]
}

#[cfg(test)]
mod tests {
    use crate::server::POLICY;

    #[test]
    fn the_page_has_the_policy_of_its_answer() {
        let page = include_str!("page/page.html");
        assert!(
            page.contains(&format!("<meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">"))
        );
    }
}
