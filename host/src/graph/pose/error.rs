//! What can be wrong with a pose graph.

/// Why a graph cannot be optimised. Poses are called by their ids, edges by their place in the list,
/// counted from 0.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// As many ids as poses are needed.
    #[error("{ids} ids for {poses} poses: expected one each")]
    Ids {
        /// Number of ids.
        ids: usize,
        /// Number of poses.
        poses: usize,
    },
    /// An edge leads to a pose that is not there.
    #[error("edge {edge} names pose index {pose}, but there are {poses} poses")]
    MissingPose {
        /// The edge.
        edge: usize,
        /// The index it names.
        pose: usize,
        /// Number of poses.
        poses: usize,
    },
    /// An edge from a pose to itself.
    #[error("edge {edge} goes from pose {id} to itself")]
    Loop {
        /// The edge.
        edge: usize,
        /// The pose.
        id: u64,
    },
    /// A pose that is to be fixed is not there.
    #[error("pose index {pose} is to be fixed, but there are {poses} poses")]
    MissingFixed {
        /// The index.
        pose: usize,
        /// Number of poses.
        poses: usize,
    },
    /// A pose with NaN or infinity.
    #[error("pose {id} is not finite")]
    PoseNotFinite {
        /// The pose.
        id: u64,
    },
    /// A measurement or information with NaN or infinity.
    #[error("edge {edge} (poses {from} to {to}) is not finite")]
    EdgeNotFinite {
        /// The edge.
        edge: usize,
        /// Id of the pose it is seen from.
        from: u64,
        /// Id of the pose that is seen.
        to: u64,
    },
    /// Information that is no inverse covariance.
    #[error("the information of edge {edge} (poses {from} to {to}) is {problem}")]
    Information {
        /// The edge.
        edge: usize,
        /// Id of the pose it is seen from.
        from: u64,
        /// Id of the pose that is seen.
        to: u64,
        /// "not symmetric" or "not positive semidefinite".
        problem: &'static str,
    },
    /// One weight is needed for every edge.
    #[error("{weights} weights for {edges} edges: expected one each")]
    Weights {
        /// Number of weights.
        weights: usize,
        /// Number of edges.
        edges: usize,
    },
    /// A weight that is negative, infinite or NaN.
    #[error("the weight of edge {edge} is {weight}: expected a finite number, 0 or more")]
    Weight {
        /// The edge.
        edge: usize,
        /// Its weight.
        weight: f64,
    },
    /// The measurements leave a pose free to move.
    #[error(
        "pose {id} is not determined by its measurements (in component {component} of its tangent): \
         their information or weights are too small or lie in one direction, or the chain to the next \
         pose that is held is too long for double precision"
    )]
    Unconstrained {
        /// The pose.
        id: u64,
        /// Which component: translation first, then rotation.
        component: usize,
    },
    /// Too few measurements agree to say where a pose is.
    #[error(
        "the measurements that lead to pose {id} contradict each other and none has support: which of \
         them are wrong cannot be decided"
    )]
    Undecided {
        /// The pose.
        id: u64,
    },
    /// χ² is not finite although every number is: values too large to square.
    #[error("the cost of the graph is not finite at edge {edge}: its numbers are too large")]
    Overflow {
        /// The edge.
        edge: usize,
    },
    /// A pose under an id that is taken.
    #[error("pose {id} is there already")]
    Repeated {
        /// The id.
        id: u64,
    },
    /// An edge between poses of which one is not, or no longer, there.
    #[error("an edge names pose {id}, which is not in the graph")]
    Unknown {
        /// The id.
        id: u64,
    },
    /// A graph with another set of edges or fixed poses than the optimiser was made for.
    #[error("the graph's {what} are not those the optimiser was made for")]
    Changed {
        /// "poses", "edges" or "fixed poses".
        what: &'static str,
    },
    /// Options outside their range.
    #[error("{option} is {value}: expected {expected}")]
    Option {
        /// Its name.
        option: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// Too densely connected a graph for what needs the factor of its normal equations.
    #[error("the graph is too densely connected for what needs a factor of its normal equations")]
    TooDense,
}
