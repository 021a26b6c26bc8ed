//! From the text of a URDF to a tree of links.

use std::collections::HashMap;
use std::path::Path;

use super::drives::{Drives, motion};
use super::problem::Problem;
use super::solids::{pose, solid};
use super::{Joint, Link, Model};

/// Greatest size of a description, bytes.
const MOST_BYTES: usize = 16 << 20;

/// How deep its elements may lie in each other; a URDF needs five levels.
const MOST_LEVELS: usize = 64;

/// Links of a hand at most.
const MOST_LINKS: usize = 256;

/// The model that the text describes; its meshes are in `folder`.
pub(super) fn parse(text: &str, folder: Option<&Path>) -> Result<Model, Problem> {
    if text.len() > MOST_BYTES {
        return Err(Problem::Many { what: "bytes", found: text.len(), most: MOST_BYTES });
    }
    // The parser calls itself for every level.
    let deep = levels(text);
    if deep > MOST_LEVELS {
        return Err(Problem::Many { what: "levels of elements", found: deep, most: MOST_LEVELS });
    }
    if text.contains("<xacro:") {
        return Err(Problem::Xacro);
    }
    let robot = urdf_rs::read_from_string(text).map_err(|e| Problem::Text(e.to_string()))?;
    if robot.links.is_empty() {
        return Err(Problem::Empty);
    }
    if robot.links.len() > MOST_LINKS {
        return Err(Problem::Many { what: "links", found: robot.links.len(), most: MOST_LINKS });
    }
    let mut index = HashMap::new();
    for (i, link) in robot.links.iter().enumerate() {
        if index.insert(link.name.as_str(), i).is_some() {
            return Err(Problem::Twice { what: "link", name: link.name.clone() });
        }
    }
    let order = order(&robot, &index)?;
    let drives = Drives::new(&robot.joints)?;

    let mut place = vec![0; robot.links.len()];
    let mut links = Vec::with_capacity(order.len());
    for (new, (old, joint)) in order.into_iter().enumerate() {
        place[old] = new;
        let link = &robot.links[old];
        let joint = match joint {
            None => None,
            Some(number) => {
                let joint = &robot.joints[number];
                let parent = index.get(joint.parent.link.as_str()).map_or(0, |p| place[*p]);
                Some(Joint {
                    name: joint.name.clone(),
                    parent,
                    origin: pose(&joint.origin, || format!("joint {:?}", joint.name))?,
                    motion: motion(joint, drives.of[number])?,
                })
            }
        };
        let solids = link.collision.iter().map(|c| solid(c, &link.name, folder));
        links.push(Link {
            name: link.name.clone(),
            joint,
            solids: solids.collect::<Result<_, _>>()?,
        });
    }
    Ok(Model { name: robot.name, links, coordinates: drives.coordinates })
}

/// How deep elements lie in each other, comments and the like left out.
fn levels(text: &str) -> usize {
    let (mut depth, mut deepest) = (0usize, 0);
    let mut rest = text;
    while let Some(at) = rest.find('<') {
        rest = &rest[at..];
        let skip = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>"), ("<!", ">")];
        if let Some((_, end)) = skip.iter().find(|(start, _)| rest.starts_with(start)) {
            match rest.find(end) {
                Some(at) => rest = &rest[at + end.len()..],
                None => break,
            }
            continue;
        }
        let end = rest.find('>').unwrap_or(rest.len());
        if rest.starts_with("</") {
            depth = depth.saturating_sub(1);
        } else if !rest[..end].ends_with('/') {
            depth += 1;
            deepest = deepest.max(depth);
        }
        rest = &rest[end.max(1)..];
    }
    deepest
}

/// The links, every one after its parent, each with the number of the joint that it hangs on.
fn order(
    robot: &urdf_rs::Robot,
    index: &HashMap<&str, usize>,
) -> Result<Vec<(usize, Option<usize>)>, Problem> {
    let count = robot.links.len();
    let mut holder: Vec<Option<usize>> = vec![None; count];
    let mut children: Vec<Vec<usize>> = vec![Vec::new(); count];
    for (number, joint) in robot.joints.iter().enumerate() {
        let find = |link: &String| {
            index
                .get(link.as_str())
                .copied()
                .ok_or_else(|| Problem::NoLink { joint: joint.name.clone(), link: link.clone() })
        };
        let (parent, child) = (find(&joint.parent.link)?, find(&joint.child.link)?);
        if let Some(first) = holder[child].replace(number) {
            return Err(Problem::TwoParents {
                link: joint.child.link.clone(),
                first: robot.joints[first].name.clone(),
                second: joint.name.clone(),
            });
        }
        children[parent].push(child);
    }
    let roots: Vec<usize> = (0..count).filter(|l| holder[*l].is_none()).collect();
    let root = match roots[..] {
        [] => return Err(Problem::NoRoot),
        [root] => root,
        _ => {
            let names: Vec<&str> = roots.iter().map(|r| robot.links[*r].name.as_str()).collect();
            return Err(Problem::Roots(names.join(", ")));
        }
    };
    let mut order = Vec::with_capacity(count);
    let mut reached = vec![false; count];
    let mut open = vec![root];
    while let Some(link) = open.pop() {
        reached[link] = true;
        order.push((link, holder[link]));
        open.extend(children[link].iter().rev());
    }
    // What no root carries hangs on itself.
    match reached.iter().position(|r| !r) {
        Some(lost) => Err(Problem::Loop { link: robot.links[lost].name.clone() }),
        None => Ok(order),
    }
}
