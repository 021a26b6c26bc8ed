//! All contacts, from single sites up to summaries of everything, for whoever looks from afar.

use std::collections::HashMap;

use super::grid::{Cell, Grid};
use super::site::{Moments, Site, show};
use crate::space::Point;

/// A summary is taken for its contacts when its side is at most this many times the distance (along
/// the axis where it is largest) from its middle to the expert's: the opening criterion of Barnes &
/// Hut, "A hierarchical O(N log N) force-calculation algorithm", Nature 324 (1986).
const OPENING: f64 = 1.0;

/// Least cosine between a contact's normal and a site's for the two to merge: sides of a thin wall,
/// or of a sharp edge, stay apart.
const ALIKE: f64 = 0.5;

const NONE: u32 = u32::MAX;

#[derive(Clone, Debug)]
struct Voxel {
    cell: Cell,
    live: Moments,
    shown: Moments,
    children: [u32; 8],
    /// On level 0.
    sites: Vec<u32>,
}

/// What an expert learns from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// A site near it, as it is now.
    Near(u32),
    /// A site farther away, as it is shown.
    Site(u32),
    /// The summary of a cell, as it is shown.
    Summary(u32),
}

/// A source and the number of contacts in it: as contacts are only added, equal numbers mean that
/// nothing has changed.
pub type Stamped = (Source, u64);

/// Sites in cells of level 0, summed up level by level.
#[derive(Clone, Debug)]
pub struct Pyramid {
    grid: Grid,
    voxels: Vec<Voxel>,
    sites: Vec<Site>,
    /// By index of the cell.
    floor: HashMap<[i64; 3], u32>,
    tops: HashMap<[i64; 3], u32>,
    /// Farthest that a contact may lie from a site's seat to merge into it: across the normal and
    /// along it, metres. Neither exceeds the side of level 0.
    reach: (f64, f64),
}

impl Pyramid {
    /// Without contacts.
    pub fn new(grid: Grid, reach: (f64, f64)) -> Pyramid {
        Pyramid {
            grid,
            voxels: Vec::new(),
            sites: Vec::new(),
            floor: HashMap::new(),
            tops: HashMap::new(),
            reach,
        }
    }

    /// All sites.
    pub fn sites(&self) -> &[Site] {
        &self.sites
    }

    /// The moments behind a source.
    pub fn moments(&self, source: Source) -> &Moments {
        match source {
            Source::Near(i) => &self.sites[i as usize].live,
            Source::Site(i) => &self.sites[i as usize].shown,
            Source::Summary(i) => &self.voxels[i as usize].shown,
        }
    }

    /// Whether there are cells at `point`.
    pub fn reaches(&self, point: &Point) -> bool {
        self.grid.cell(point, 0).is_some()
    }

    /// Takes one contact in. The seat of the site it made, if it joined none. The contact must lie
    /// where [`Pyramid::reaches`].
    pub fn add(&mut self, contact: &Moments) -> Option<Point> {
        let (home, new) = match self.mergeable(contact) {
            Some(site) => {
                let site = &mut self.sites[site as usize];
                site.live.add(contact);
                show(&site.live, &mut site.shown);
                (site.seat, None)
            }
            None => {
                self.sites.push(Site::new(*contact));
                (contact.centroid, Some(self.sites.len() as u32 - 1))
            }
        };
        let mut voxel = self.descend(&home, contact)?;
        loop {
            let v = &mut self.voxels[voxel as usize];
            if v.cell.level == 0 {
                v.sites.extend(new);
                return new.map(|_| home);
            }
            let cell = self.grid.cell(&home, v.cell.level - 1)?;
            let octant = self.grid.octant(&cell);
            let child = v.children[octant];
            voxel = if child == NONE {
                let child = self.push(cell, contact);
                self.voxels[voxel as usize].children[octant] = child;
                child
            } else {
                self.grow(child, contact);
                child
            };
        }
    }

    /// The top voxel at `home`, which takes the contact in.
    fn descend(&mut self, home: &Point, contact: &Moments) -> Option<u32> {
        let cell = self.grid.cell(home, self.grid.top())?;
        Some(match self.tops.get(&cell.index) {
            Some(&top) => {
                self.grow(top, contact);
                top
            }
            None => {
                let top = self.push(cell, contact);
                self.tops.insert(cell.index, top);
                top
            }
        })
    }

    fn push(&mut self, cell: Cell, contact: &Moments) -> u32 {
        let index = self.voxels.len() as u32;
        let (live, shown) = (*contact, *contact);
        self.voxels.push(Voxel { cell, live, shown, children: [NONE; 8], sites: Vec::new() });
        if cell.level == 0 {
            self.floor.insert(cell.index, index);
        }
        index
    }

    fn grow(&mut self, voxel: u32, contact: &Moments) {
        let voxel = &mut self.voxels[voxel as usize];
        voxel.live.add(contact);
        show(&voxel.live, &mut voxel.shown);
    }

    /// The nearest site the contact may join. The region about a seat is a disc across the normal,
    /// thick along it: were it cut along the normal closer than the noise reaches, each part would
    /// hold the contacts whose noise points one way, and their mean would be off.
    fn mergeable(&self, contact: &Moments) -> Option<u32> {
        let (across, along) = self.reach;
        let cell = self.grid.cell(&contact.centroid, 0)?;
        let mut best: Option<(f64, u32)> = None;
        for near in self.grid.around(&cell) {
            let Some(&voxel) = self.floor.get(&near.index) else { continue };
            for &index in &self.voxels[voxel as usize].sites {
                let site = &self.sites[index as usize];
                let apart = contact.centroid - site.seat;
                let (ours, theirs) = (contact.direction(), site.live.direction());
                let facing = match (ours, theirs) {
                    (Some(a), Some(b)) => a.dot(&b) >= ALIKE,
                    _ => true,
                };
                let fits = match theirs.or(ours) {
                    Some(normal) => {
                        let height = normal.dot(&apart);
                        height.abs() <= along
                            && apart.norm_squared() - height * height <= across * across
                    }
                    None => apart.norm() <= along,
                };
                let distance = apart.norm_squared();
                if facing && fits && best.is_none_or(|b| distance < b.0) {
                    best = Some((distance, index));
                }
            }
        }
        best.map(|b| b.1)
    }

    /// How many sites have their seat within `half` metres of `centre` along every axis.
    pub fn count(&self, cell: &Cell, half: f64) -> usize {
        let centre = self.grid.centre(cell);
        let mut count = 0;
        self.visit(cell, |_, voxel, apart, side| {
            if apart - 0.5 * side > half {
                return false;
            }
            let inside =
                |i: &&u32| self.grid.reach(&self.sites[**i as usize].seat, &centre) <= half;
            count += voxel.sites.iter().filter(inside).count();
            true
        });
        count
    }

    /// All contacts as the expert of `cell` sees them: the sites within `half` metres of its middle
    /// along every axis, and summaries of the others, the coarser the farther away. Contacts
    /// farther than the cells of the top level around it are left out.
    pub fn sources(&self, cell: &Cell, half: f64) -> Vec<Stamped> {
        let centre = self.grid.centre(cell);
        let mut sources = Vec::new();
        self.visit(cell, |index, voxel, apart, side| {
            if apart - 0.5 * side > half && side <= OPENING * apart && voxel.shown.count > 1 {
                sources.push((Source::Summary(index), voxel.shown.count));
                return false;
            }
            for &i in &voxel.sites {
                let site = &self.sites[i as usize];
                sources.push(if self.grid.reach(&site.seat, &centre) <= half {
                    (Source::Near(i), site.live.count)
                } else {
                    (Source::Site(i), site.shown.count)
                });
            }
            true
        });
        sources
    }

    /// Walks down from the top cells about `cell`: index, voxel, distance of its middle from the
    /// cell's, side. The visitor says whether to go on to the children.
    fn visit(&self, cell: &Cell, mut visitor: impl FnMut(u32, &Voxel, f64, f64) -> bool) {
        let centre = self.grid.centre(cell);
        let Some(top) = self.grid.cell(&centre, self.grid.top()) else { return };
        let around = self.grid.around(&top);
        let mut open: Vec<u32> = around.filter_map(|c| self.tops.get(&c.index).copied()).collect();
        open.reverse();
        while let Some(index) = open.pop() {
            let voxel = &self.voxels[index as usize];
            let apart = self.grid.reach(&self.grid.centre(&voxel.cell), &centre);
            if visitor(index, voxel, apart, self.grid.side(voxel.cell.level)) {
                open.extend(voxel.children.iter().rev().filter(|c| **c != NONE));
            }
        }
    }
}
