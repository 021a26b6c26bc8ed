//! Contacts that are taken out with what they said.

use super::{Gpis, Site};
use crate::contact::Contact;
use crate::math;
use crate::matrix::Coordinates;
use crate::space::Space;
use crate::surface::kernel::Kernel;
use crate::surface::prior::Prior;

impl<S: Space, K: Kernel, P: Prior<S>, const SITES: usize, const ROWS: usize, const PACKED: usize>
    Gpis<S, K, P, SITES, ROWS, PACKED>
{
    /// The contacts held, with the noise they came with. Their normals have learnt from others.
    pub(in crate::surface) fn held(&self) -> impl Iterator<Item = Contact<S>> + '_ {
        self.leaders().map(|leader| Self::felt(&self.sites[leader]))
    }

    fn felt(site: &Site<S>) -> Contact<S> {
        Contact {
            point: site.point,
            normal: if site.felt { site.normal.normalized() } else { None },
            point_deviation: math::sqrt(site.noise),
            normal_deviation: math::sqrt(site.turn_noise),
            finger: 0,
        }
    }

    /// Takes out the contacts for which `is_gone` and hands nothing on of what they said; what their
    /// neighbours learnt from others stays.
    pub(in crate::surface) fn forget(&mut self, is_gone: impl Fn(&Contact<S>) -> bool) {
        let mut leader = 0;
        for _ in 0..SITES {
            let Some(site) = self.sites[..self.count].get(leader) else { return };
            let next = leader + 1 + usize::from(site.followers);
            if !is_gone(&Self::felt(site)) {
                leader = next;
                continue;
            }
            let first = usize::from(site.row);
            let rows: usize = self.sites[leader..next].iter().map(Site::rows).sum();
            for row in (first..first + rows).rev() {
                self.forget_row(row);
            }
            self.sites.copy_within(next..self.count, leader);
            self.count -= next - leader;
            for later in &mut self.sites[leader..self.count] {
                later.row -= rows as u16;
            }
        }
    }
}
