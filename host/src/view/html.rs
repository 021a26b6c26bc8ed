//! `replay.html`: a scene and its viewer in one file that opens from disk, without a network.
//!
//! The viewer is plain JavaScript and WebGL 2 in `host/assets/viewer`, put together here at compile
//! time. The same page without a scene connects to a WebSocket that sends one ([`live`]).

use std::io::{self, Write};

use super::scene::Scene;

const TEMPLATE: &str = include_str!("../../assets/viewer/index.html");
const STYLE: &str = include_str!("../../assets/viewer/style.css");

/// In the order in which they build on each other.
const SCRIPTS: [&str; 10] = [
    include_str!("../../assets/viewer/pose.js"),
    include_str!("../../assets/viewer/colour.js"),
    include_str!("../../assets/viewer/scene.js"),
    include_str!("../../assets/viewer/camera.js"),
    include_str!("../../assets/viewer/webgl.js"),
    include_str!("../../assets/viewer/painter.js"),
    include_str!("../../assets/viewer/picture.js"),
    include_str!("../../assets/viewer/charts.js"),
    include_str!("../../assets/viewer/player.js"),
    include_str!("../../assets/viewer/selftest.js"),
];

/// Writes the page of a scene. It does not say more than a browser needs: nothing of this machine.
///
/// ```
/// use tactile_host::view::{html, scene::{Grasp, Meta, Scene}};
///
/// let scene = Scene {
///     meta: Meta::new(2, "three touches"),
///     grasps: (0..3).map(|grasp| Grasp { grasp, merged: 1, ..Grasp::default() }).collect(),
///     surfaces: vec![],
///     choices: vec![],
/// };
/// let mut page = Vec::new();
/// html::write(&scene, &mut page)?;
/// assert!(page.starts_with(b"<!doctype html>"));
/// # Ok::<(), std::io::Error>(())
/// ```
///
/// # Errors
/// When the writer fails.
pub fn write(scene: &Scene, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    let page = page(&scene.meta.title, None);
    let (before, after) = page.split_once(SCENE).unwrap_or((&page, ""));
    out.write_all(before.as_bytes())?;
    for message in scene.messages() {
        // In JSON `<` is part of a string only: escaped there, nothing can end the element.
        let line = message.to_json()?.replace('<', "\\u003c");
        writeln!(out, "{line}")?;
    }
    out.write_all(after.as_bytes())
}

/// The page that shows what the WebSocket at `address` sends, one message
/// ([`super::scene::Message`]) a frame of text, and connects again when it breaks off. An address that
/// starts with `/` is on the host that served the page, else it is `ws://host:port/path`.
pub fn live(address: &str) -> String {
    page("tactile live", Some(address)).replace(SCENE, "")
}

const SCENE: &str = "{{scene}}";

fn page(title: &str, live: Option<&str>) -> String {
    TEMPLATE
        .replace("{{title}}", &escaped(title))
        .replace("{{live}}", &escaped(live.unwrap_or_default()))
        .replace("{{style}}", STYLE)
        .replace("{{script}}", &SCRIPTS.concat())
}

/// Text as it may stand in an element or in a quoted attribute. Braces too, so that no text is taken
/// for a place of the template.
fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' | '<' | '>' | '"' | '\'' | '{' | '}' => {
                safe.push_str(&format!("&#{};", u32::from(c)));
            }
            c => safe.push(c),
        }
    }
    safe
}

#[cfg(test)]
#[path = "html_tests.rs"]
mod tests;
