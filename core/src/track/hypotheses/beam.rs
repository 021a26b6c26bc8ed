//! Partial answers of a search, the best of which are kept.

use crate::matrix::Coordinates;
use crate::space::Space;

/// Contacts that are explained together; a larger grasp is taken in parts.
pub(super) const TOUCHES: usize = 16;

/// Where a contact belongs: nowhere, on a face that it opens, or on face `label − FACE`.
pub(super) const WILD: u8 = 0;
pub(super) const OPENS: u8 = 1;
pub(super) const FACE: u8 = 2;

/// An answer for the first contacts of a grasp.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node<S: Space> {
    pub labels: [u8; TOUCHES],
    /// Where the pose is, as a tangent at the predicted one.
    pub tangent: S::Tangent,
    /// Log evidence.
    pub score: f32,
}

impl<S: Space> Node<S> {
    pub const UNSET: Self = Node { labels: [WILD; TOUCHES], tangent: S::Tangent::ZERO, score: 0.0 };
}

/// A list of at most `N` answers, best first; no two with the same labels.
#[derive(Clone, Debug)]
pub(super) struct Beam<S: Space, const N: usize> {
    nodes: [Node<S>; N],
    count: usize,
}

impl<S: Space, const N: usize> Beam<S, N> {
    pub const fn new() -> Self {
        Beam { nodes: [Node::UNSET; N], count: 0 }
    }

    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Starts anew: no contacts yet, at this tangent.
    pub fn start(&mut self, tangent: S::Tangent) {
        self.nodes[0] = Node { tangent, ..Node::UNSET };
        self.count = 1;
    }

    pub fn as_slice(&self) -> &[Node<S>] {
        &self.nodes[..self.count]
    }

    /// Keeps the node when it is among the best `width`.
    pub fn offer(&mut self, node: Node<S>, width: usize) {
        let width = width.min(N);
        if !node.score.is_finite() {
            return;
        }
        if let Some(same) = self.as_slice().iter().position(|n| n.labels == node.labels) {
            if self.nodes[same].score >= node.score {
                return;
            }
            self.nodes.copy_within(same + 1..self.count, same);
            self.count -= 1;
        }
        let mut place = self.count;
        while place > 0 && self.nodes[place - 1].score < node.score {
            place -= 1;
        }
        if place >= width {
            return;
        }
        self.count = (self.count + 1).min(width);
        self.nodes.copy_within(place..self.count - 1, place + 1);
        self.nodes[place] = node;
    }
}
