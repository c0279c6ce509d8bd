//! The page of a room for people whom relays serve: that of the embedded server, with another way to the room.
//!
//! It speaks to relays by WebTransport, and where that is not to be had by WebSocket, through `@moq/net`, which npm installs and
//! bundles (`page/package.json`).

use std::sync::Arc;

use handcast_live::page::parts;
use handcast_live::server::{POLICY, Part};
use handcast_live::transport::TransportError;
use url::Url;

/// The first module that the page names in its head, so that all are asked for at once.
const FIRST_MODULE: &str = "<link rel=\"modulepreload\" href=\"link.js\">";

/// Where a page finds its room.
#[derive(Clone, Debug)]
pub struct Place<'a> {
    /// Relays in the order in which they are tried.
    pub relays: &'a [Url],
    /// Room on them.
    pub room: &'a str,
    /// SHA-256 of the certificates that relays have made themselves, in hex. Browsers take such that hold for two weeks at most.
    pub fingerprints: &'a [String],
}

impl Place<'_> {
    /// The page's files. `library` is `@moq/net` as one module.
    ///
    /// # Errors
    /// What of the place is not allowed.
    pub fn parts(&self, library: &[u8]) -> Result<Vec<Part>, TransportError> {
        const SCRIPT: &str = "text/javascript; charset=utf-8";
        self.check()?;
        let policy = self.policy();
        let modules = ["moq-net", "freshness", "place", "wire", "room", "link"]
            .map(|name| FIRST_MODULE.replace("link.js", &format!("{name}.js")));
        let modules = modules.join("\n");
        let mut parts = parts(true);
        for part in &mut parts {
            match part.name.as_ref() {
                "" => {
                    let page = String::from_utf8_lossy(&part.bytes).replace(POLICY, &policy);
                    part.bytes = page.replace(FIRST_MODULE, &modules).into_bytes().into();
                }
                "link.js" => part.bytes = Arc::from(include_bytes!("page/link.js").as_slice()),
                _ => {}
            }
        }
        parts.push(Part::new("freshness.js", SCRIPT, include_str!("page/freshness.js")));
        parts.push(Part::new("place.js", SCRIPT, self.script()));
        parts.push(Part::new("moq-net.js", SCRIPT, library));
        Ok(parts)
    }

    /// What the page may do: what that of the embedded server may, and speak with the relays.
    pub fn policy(&self) -> String {
        let mut connect = "connect-src 'self'".to_owned();
        for relay in self.relays {
            let (host, secure) =
                (&relay[url::Position::BeforeHost..url::Position::AfterPort], is_secure(relay));
            let schemes: &[&str] = if secure { &["https", "wss"] } else { &["https", "http", "ws"] };
            schemes.iter().for_each(|scheme| connect.push_str(&format!(" {scheme}://{host}")));
        }
        POLICY.replace("connect-src 'self'", &connect)
    }

    /// Refuses what could be more than a name in a script or a policy.
    fn check(&self) -> Result<(), TransportError> {
        let refused = |why: String| Err(TransportError::Refused { why });
        let plain = |b: u8| b.is_ascii_alphanumeric() || b"-_./".contains(&b);
        if self.room.is_empty() || !self.room.bytes().all(plain) {
            return refused(format!("room {:?}: allowed are letters, digits and - _ . /", self.room));
        }
        if let Some(relay) = self.relays.iter().find(|relay| {
            !["https", "http"].contains(&relay.scheme())
                || relay.as_str().bytes().any(|b| b"'\"\\;, ".contains(&b))
        }) {
            return refused(format!(
                "relay {relay}: pages take https://HOST:PORT/PATH, of this machine also http://"
            ));
        }
        let hex = |text: &&String| text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit());
        match self.fingerprints.iter().find(|text| !hex(text)) {
            Some(text) => refused(format!("fingerprint {text:?}: allowed are 64 hexadecimal digits")),
            None => Ok(()),
        }
    }

    /// The place as a module.
    fn script(&self) -> String {
        let list =
            |texts: Vec<&str>| texts.iter().map(|text| format!("\"{text}\"")).collect::<Vec<_>>().join(", ");
        let relays = list(self.relays.iter().map(Url::as_str).collect());
        let fingerprints = list(self.fingerprints.iter().map(String::as_str).collect());
        format!(
            "export default {{ relays: [{relays}], room: \"{}\", fingerprints: [{fingerprints}] }};\n",
            self.room
        )
    }
}

fn is_secure(relay: &Url) -> bool {
    relay.scheme() == "https"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_may_speak_with_its_relays_and_knows_its_room() {
        let relays = ["https://a.example/", "http://localhost:4443/x"].map(|url| url.parse().unwrap());
        let fingerprints = ["ab".repeat(32)];
        let place = Place { relays: &relays, room: "hands/1f", fingerprints: &fingerprints };
        let parts = place.parts(b"library").unwrap();
        let text = |name: &str| {
            let part = parts.iter().find(|part| part.name == name).unwrap();
            String::from_utf8(part.bytes.to_vec()).unwrap()
        };
        let connect = "connect-src 'self' https://a.example wss://a.example https://localhost:4443 http://localhost:4443 ws://localhost:4443;";
        assert!(place.policy().contains(connect), "{}", place.policy());
        assert!(text("").contains(&place.policy()));
        for part in parts.iter().filter(|part| part.name.ends_with(".js")) {
            let loaded =
                [format!("src=\"{}\"", part.name), format!("modulepreload\" href=\"{}\"", part.name)];
            let named = loaded.iter().any(|loaded| text("").contains(loaded));
            // What sends is asked for when somebody sends.
            let sends = ["send.js", "handcast.js", "handcast-sender.js", "sender-worker.js"];
            assert!(named || sends.contains(&part.name.as_ref()), "{}", part.name);
        }
        let list = r#"relays: ["https://a.example/", "http://localhost:4443/x"], room: "hands/1f""#;
        assert!(text("place.js").contains(list), "{}", text("place.js"));
        assert!(text("link.js").contains("./moq-net.js") && text("moq-net.js") == "library");
    }

    /// What the page is given in place of the library: relays that announce whom `tell` says, and keep what is published.
    const LIBRARY: &str = r#"
        export const state = { events: [], waiters: [], frames: [] };
        export const tell = (path, active) => { state.events.push({ path, active }); state.waiters.splice(0).forEach(go => go()); };
        export const Path = { from: path => path, join: (a, b) => `${a}/${b}` };
        export const Time = { Timestamp: { fromMillis: time => time } };
        export const Broadcast = { Producer: class { createTrack() { return { writeGroup() {}, close() {} }; } close() {} } };
        export const Group = { Producer: class { writeFrame({ payload }) { state.frames.push(payload.length); } close() {} } };
        const never = new Promise(() => {});
        const next = async () => {
            while (!state.events.length) await new Promise(go => state.waiters.push(go));
            return state.events.shift();
        };
        const track = () => ({ info: async () => {}, subscribe: () => ({ nextGroup: () => never }) });
        const connection = { closed: never, close() {}, announced: () => ({ next }), consume: () => ({ track, close() {} }), publish() {} };
        export const Connection = { connect: async () => connection };
    "#;

    /// The 17th is read when a number is free, and the page's own hands are not sent before; while they rest it says its hello.
    #[test]
    #[ignore = "needs node"]
    fn a_page_in_a_full_room_waits_and_one_at_rest_is_there() {
        let relays = ["https://a.example/".parse().unwrap()];
        let place = Place { relays: &relays, room: "r", fingerprints: &[] };
        let folder = tempfile::tempdir().unwrap();
        for part in place.parts(LIBRARY.as_bytes()).unwrap().iter().filter(|part| part.name.ends_with(".js"))
        {
            std::fs::write(folder.path().join(&*part.name), &part.bytes).unwrap();
        }
        let script = r#"
            const [folder] = process.argv.slice(1);
            const [{ link }, wire, { state, tell }] = await Promise.all(["link", "wire", "moq-net"].map(name => import(`${folder}/${name}.js`)));
            const sleep = ms => new Promise(go => setTimeout(go, ms));
            const taken = [];
            const way = link({ opened() {}, closed() {}, heard() {}, now: () => 0, take: message => taken.push(message.kind) });
            await sleep(50);
            for (let n = 0; n < 18; n += 1) tell(`s${n}`, true);
            await sleep(50);
            const leftOut = [...way.leftOut];
            way.say(wire.hello(["left"], []));
            const goes = async path => { tell(path, false); way.senders.get(path).heard -= 5000; await sleep(1200); };
            tell("s17", false);
            await goes("s3");
            const late = way.senders.get("s16").number;
            await goes("s5");
            way.say(wire.hello(["left"], []));
            const { number } = way.own;
            way.say(wire.plane({ period: 0, index: 0, time: 0, lost: {}, payload: new Uint8Array([0, 0, 1, 9]) }));
            await sleep(3700);
            const said = state.frames.length;
            way.say(wire.end());
            await sleep(1700);
            console.log(JSON.stringify({ leftOut, late, number, taken, said, behind: state.frames.length - said }));
            process.exit();
        "#;
        let root = format!("file://{}", folder.path().display());
        let out = std::process::Command::new("node")
            .args(["--input-type=module", "-e", script, &root])
            .output()
            .unwrap();
        let told: serde_json::Value = serde_json::from_slice(&out.stdout)
            .unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&out.stderr)));
        let said = told["said"].as_u64().unwrap();
        assert!((3..=4).contains(&said), "the period's first frame, and two or three hellos: {told}");
        let expected = serde_json::json!({
            "leftOut": ["s16", "s17"], "late": 3, "number": 5, "taken": ["refused", "hello", "plane", "end"], "said": said,
            "behind": 1,
        });
        assert_eq!(told, expected);
    }

    #[test]
    fn names_that_are_more_than_names_are_refused() {
        let relays = ["https://a.example/".parse().unwrap()];
        let strange = ["wss://a.example/".parse().unwrap()];
        let fingerprints = ["\"".repeat(64)];
        for place in [
            Place { relays: &relays, room: "a\";alert(1)//", fingerprints: &[] },
            Place { relays: &strange, room: "a", fingerprints: &[] },
            Place { relays: &relays, room: "a", fingerprints: &fingerprints },
        ] {
            assert!(place.parts(b"").is_err(), "{place:?}");
        }
    }
}
