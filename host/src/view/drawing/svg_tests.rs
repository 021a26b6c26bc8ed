use super::*;
use crate::view::canvas::{Canvas, Frame};
use crate::view::colour::{INK, PAPER};

/// An element: its name, its attributes as they are written, and how deep it lies.
#[derive(Debug, PartialEq)]
pub(crate) struct Element {
    pub name: String,
    pub attributes: Vec<(String, String)>,
    pub depth: usize,
    /// What stands directly behind its opening tag, still escaped.
    pub text: String,
}

/// The elements of a document, which must be well-formed as far as we write it: a declaration, then
/// one root, tags that close in order, attributes in quotes and each once, no bare `<` or `&`.
pub(crate) fn elements(document: &str) -> Result<Vec<Element>, String> {
    let body = document
        .strip_prefix("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n")
        .ok_or("no declaration")?;
    let sound = |text: &str| {
        let entities = ["amp;", "lt;", "gt;", "quot;"];
        let bare =
            text.split('&').skip(1).any(|rest| !entities.iter().any(|e| rest.starts_with(e)));
        let barred = |c: char| (c < ' ' && c != '\n') || c == '\u{fffe}' || c == '\u{ffff}';
        !bare && !text.contains(barred)
    };
    let (mut found, mut open): (Vec<Element>, Vec<String>) = (Vec::new(), Vec::new());
    let mut parts = body.split('<');
    if !parts.next().is_some_and(|before| before.trim().is_empty()) {
        return Err("text before the root".into());
    }
    for part in parts {
        let (tag, text) = part.split_once('>').ok_or(format!("tag without end: {part}"))?;
        if text.contains('>') || !sound(text) {
            return Err(format!("text: {text}"));
        }
        if let Some(name) = tag.strip_prefix('/') {
            if open.pop().as_deref() != Some(name) {
                return Err(format!("</{name}> closes another"));
            }
            if open.is_empty() && !text.trim().is_empty() {
                return Err("text behind the root".into());
            }
            continue;
        }
        if open.is_empty() && !found.is_empty() {
            return Err("a second root".into());
        }
        let alone = tag.ends_with('/');
        let mut rest = tag.trim_end_matches('/');
        let name = rest.split(' ').next().unwrap_or_default().to_owned();
        rest = &rest[name.len()..];
        let mut attributes: Vec<(String, String)> = Vec::new();
        while !rest.trim().is_empty() {
            let (key, value) = rest.split_once("=\"").ok_or(format!("attribute: {rest}"))?;
            let (value, behind) = value.split_once('"').ok_or(format!("quotes: {rest}"))?;
            let key = key.strip_prefix(' ').ok_or(format!("no space before {key}"))?;
            let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == ':';
            if !key.chars().all(plain) || !sound(value) || attributes.iter().any(|a| a.0 == key) {
                return Err(format!("attribute {key}"));
            }
            attributes.push((key.into(), value.into()));
            rest = behind;
        }
        found.push(Element {
            name: name.clone(),
            attributes,
            depth: open.len(),
            text: text.into(),
        });
        if !alone {
            open.push(name);
        }
    }
    if open.is_empty() { Ok(found) } else { Err(format!("left open: {open:?}")) }
}

fn of<'a>(elements: &'a [Element], name: &str) -> Vec<&'a Element> {
    elements.iter().filter(|e| e.name == name).collect()
}

fn attribute<'a>(element: &'a Element, name: &str) -> Option<&'a str> {
    element.attributes.iter().find(|a| a.0 == name).map(|a| a.1.as_str())
}

#[test]
fn the_check_knows_what_is_not_well_formed() {
    let declared =
        |body: &str| elements(&format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n{body}"));
    assert_eq!(declared("<a><b c=\"1\"/>&amp;</a>").unwrap().len(), 2);
    for bad in ["<a>", "<a></b>", "<a/><a/>", "<a b=c/>", "<a b=\"1\" b=\"2\"/>", "<a>&x</a>", "a"]
    {
        assert!(declared(bad).is_err(), "{bad}");
    }
    assert!(elements("<a/>").is_err());
}

#[test]
fn text_stays_text_and_says_what_it_said() {
    let mut canvas = Canvas::new(200, 100, PAPER).unwrap();
    let style = Style::new(14.0, INK);
    canvas.text([10.0, 20.0], style, "a < b & \"c\" > d's \u{1}end\n");
    canvas.text([190.0, 50.0], style.bold().anchored(Anchor::End), "± 2 °");
    let svg = canvas.finish().svg();
    let found = elements(&svg).unwrap();
    let texts = of(&found, "text");
    assert_eq!(texts[0].text, "a &lt; b &amp; &quot;c&quot; &gt; d's \u{fffd}end ");
    assert_eq!(attribute(texts[0], "font-size"), Some("14"));
    assert_eq!(texts[1].text, "± 2 °");
    assert_eq!(attribute(texts[1], "text-anchor"), Some("end"));
    assert_eq!(attribute(texts[1], "font-weight"), Some("bold"));
}

#[test]
fn shapes_stay_shapes_and_what_is_not_a_number_is_left_out() {
    let mut canvas = Canvas::new(100, 100, PAPER).unwrap();
    let nan = f32::NAN;
    canvas.fill_dot([5.0, nan], 3.0, INK);
    canvas.fill_dot([5.0, 6.0], f32::INFINITY, INK);
    canvas.fill_dot([5.0, 6.0], 3.0, INK.faded(0.5));
    canvas.text([nan, 0.0], Style::new(12.0, INK), "nowhere");
    canvas.fill_frame(&Frame { left: 0.0, top: 0.0, width: nan, height: 4.0 }, INK);
    canvas.line(&[[0.0, 0.0], [1.0, 1.0], [nan, 2.0], [3.0, 3.0], [4.0, 4.5]], 2.0, INK);
    canvas.fill_area(&[vec![[0.0, 0.0], [1e30, 0.0], [9.0, f32::NEG_INFINITY], [0.0, 9.0]]], INK);
    let found = elements(&canvas.finish().svg()).unwrap();
    assert_eq!(of(&found, "circle").len(), 1);
    assert_eq!(attribute(of(&found, "circle")[0], "fill-opacity"), Some("0.5"));
    assert_eq!(of(&found, "text").len(), 0);
    assert_eq!(of(&found, "rect").len(), 1, "the background");
    let paths: Vec<_> = of(&found, "path").iter().filter_map(|p| attribute(p, "d")).collect();
    assert_eq!(paths[..2], ["M0 0L1 1", "M3 3L4 4.5"], "a line stops where it is not known");
    assert_eq!(paths[2], "M0 0L100000 0L0 9Z");
}

#[test]
fn an_inset_is_cut_off_and_pixels_come_along() {
    let mut inner = Canvas::new(20, 10, PAPER).unwrap();
    inner.overlay(0.0, 0.0, 2, &[[1.0, 0.0, 0.0, 1.0]; 4]);
    let mut canvas = Canvas::new(100, 100, PAPER).unwrap();
    canvas.place([30.0, 40.4], inner);
    let found = elements(&canvas.finish().svg()).unwrap();
    let inset = of(&found, "svg")[1];
    assert_eq!(attribute(inset, "overflow"), Some("hidden"));
    assert_eq!((attribute(inset, "x"), attribute(inset, "y")), (Some("30"), Some("40")));
    let image = of(&found, "image")[0];
    assert_eq!(image.depth, 2);
    let content = attribute(image, "xlink:href").unwrap();
    assert!(content.starts_with("data:image/png;base64,iVBORw0KGgo"), "{content}");
}

#[test]
fn numbers_are_short() {
    for (value, text) in
        [(1.0, "1"), (-0.001, "0"), (2.5, "2.5"), (1.005e3, "1005"), (-3.24159, "-3.24")]
    {
        assert_eq!(number(value), text);
    }
}
