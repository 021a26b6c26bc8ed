//! Which part of a comparison to run.

use clap::Args;

use super::{
    CONSISTENCY, EXPLORATION, MUJOCO, PLANNING, POSE_GRAPH_OUTLIERS, POSE_GRAPHS, SHAPES, SOLIDS,
    TRACKING,
};
use crate::experiment::exploration::{Among, Goal};
use crate::experiment::model::Model;
use crate::experiment::shapes;
use crate::experiment::tracking::Contender;
use crate::explore::Criterion;
use crate::graph;
use crate::quantity::{self, Displacement};

/// Which part of a comparison to run: all of it together runs for hours.
#[derive(Debug, PartialEq, Args)]
#[command(
    next_help_heading = "Only for shapes, tracking, mujoco, pose-graphs, table-4.2, table-4.3 and their like"
)]
pub(super) struct PartArgs {
    /// Only objects (of mujoco: recordings, of pose-graphs: graphs) whose name holds this, such as ycb/ or
    /// box; or, of shapes and tracking, any object as in simulate, also random:2,SEED or random:3,SEED. One
    /// each time: names have commas
    #[arg(long, value_name = "OBJECT")]
    pub object: Vec<String>,
    /// The first seed [default: 0]
    #[arg(long, value_name = "SEED")]
    pub first_seed: Option<u64>,
    /// Of shapes: standard deviations of contact points and normals [default: 1mm,5deg]; of tracking:
    /// motion noise in percent of 10 mm and 20° (in space 11.5° per axis) [default: 25,50,100]
    #[arg(long, value_name = "NOISE", allow_hyphen_values = true)]
    pub noise: Option<String>,
    /// Of shapes: only these numbers of contacts [default: 5 to 60 in the plane, 5 to 200 in space]
    #[arg(long, value_name = "N", value_delimiter = ',',
          value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=1024))]
    pub contacts: Vec<usize>,
    /// Of shapes: only these models, and auto: gp, faces, thesis-se, thesis-tp, superquadric, nagata,
    /// occupancy, cloud [default: all]
    #[arg(long, value_name = "MODEL", value_delimiter = ',', value_parser = shapes::model)]
    pub model: Vec<Model>,
    /// Of tracking and mujoco: only this tracker, one each time: any of slam's; literal (the thesis' filter
    /// as printed), ekf, ukf or manifold; oracle (true poses), batch (the joint graph from those), bound (not
    /// of mujoco) or odometry (none but the hand's); of table-4.3 and solids-moving: this one of slam's
    /// instead of those that suit the objects
    #[arg(long, value_name = "TRACKER")]
    pub tracker: Vec<Contender>,
    /// Of tracking, mujoco and table-4.3: what corrects the trackers' poses afterwards [default: none, of
    /// table-4.3 planes]
    #[arg(long, value_enum)]
    pub graph: Option<graph::Kind>,
    /// Of tracking: carry the object so far away before the middle grasp, turned so much, of which logs say
    /// nothing
    #[arg(long, value_name = "LENGTH,ANGLE", value_parser = quantity::displacement, allow_hyphen_values = true)]
    pub carried: Option<Displacement>,
    /// Of shapes and tracking: which part of the contacts is wild [default: 0]; of pose-graph-outliers: only this
    /// part of the closures false, at random and in groups [default: 0.1, 0.3 and 0.5]
    #[arg(long, value_name = "PART", allow_negative_numbers = true)]
    pub outliers: Option<f64>,
    /// Of tracking: how many in a run [default: 16 in the plane, 20 in space]
    #[arg(long, value_name = "N")]
    pub grasps: Option<usize>,
    /// Of table-4.2 and table-4.3: only rows of these criteria, any of explore's
    #[arg(long, value_enum, value_name = "CRITERION", value_delimiter = ',')]
    pub criterion: Vec<Criterion>,
    /// Of table-4.2 and table-4.3: only rows that choose among these
    #[arg(long, value_enum, value_delimiter = ',')]
    pub candidates: Vec<Among>,
    /// Of table-4.2 and table-4.3: only rows with these goals: lenient or strict, and of table-4.3
    /// lenient+pose or strict+pose, where the last pose must be known, too
    #[arg(long, value_name = "GOAL", value_delimiter = ',')]
    pub until: Vec<Goal>,
}

impl PartArgs {
    /// The options that were given, each with the experiments that take it.
    pub(super) fn given(&self) -> impl Iterator<Item = (&'static str, &'static [&'static str])> {
        const COMPARISONS: &[&str] = &[
            SHAPES,
            TRACKING,
            CONSISTENCY,
            POSE_GRAPH_OUTLIERS,
            EXPLORATION[0],
            EXPLORATION[1],
            SOLIDS[0],
            SOLIDS[1],
            SOLIDS[2],
            PLANNING,
        ];
        const NOISY: &[&str] = &[SHAPES, TRACKING, CONSISTENCY];
        const TRACKERS: &[&str] = &[TRACKING, CONSISTENCY, MUJOCO, EXPLORATION[1], SOLIDS[1]];
        const SIMULATED: &[&str] = &[TRACKING, CONSISTENCY];
        const ALL: &[&str] = &[
            SHAPES,
            TRACKING,
            CONSISTENCY,
            MUJOCO,
            POSE_GRAPHS,
            POSE_GRAPH_OUTLIERS,
            EXPLORATION[0],
            EXPLORATION[1],
            SOLIDS[0],
            SOLIDS[1],
            SOLIDS[2],
            PLANNING,
        ];
        const SPOILED: &[&str] = &[SHAPES, TRACKING, CONSISTENCY, POSE_GRAPH_OUTLIERS];
        const CORRECTED: &[&str] = &[TRACKING, MUJOCO, EXPLORATION[1]];
        let options: [(_, &'static [&'static str], bool); 13] = [
            ("--object", ALL, !self.object.is_empty()),
            ("--first-seed", COMPARISONS, self.first_seed.is_some()),
            ("--noise", NOISY, self.noise.is_some()),
            ("--contacts", &[SHAPES], !self.contacts.is_empty()),
            ("--model", &[SHAPES], !self.model.is_empty()),
            ("--tracker", TRACKERS, !self.tracker.is_empty()),
            ("--graph", CORRECTED, self.graph.is_some()),
            ("--carried", SIMULATED, self.carried.is_some()),
            ("--outliers", SPOILED, self.outliers.is_some()),
            ("--grasps", SIMULATED, self.grasps.is_some()),
            ("--criterion", &EXPLORATION, !self.criterion.is_empty()),
            ("--candidates", &EXPLORATION, !self.candidates.is_empty()),
            ("--until", &EXPLORATION, !self.until.is_empty()),
        ];
        options.into_iter().filter_map(|(name, takers, given)| given.then_some((name, takers)))
    }
}
