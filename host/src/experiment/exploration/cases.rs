//! Which rows tables 4.2 and 4.3 have, and which of them are asked for.

use std::fmt;
use std::str::FromStr;

use super::TableOf;
use crate::explore::{Candidates, Criterion, Until};
use crate::graph;
use crate::sim::{ObjectError, ObjectSpec};
use crate::slam::trackers::Kind;

/// The thesis' object.
const RECTANGLE: &str = "rectangle:0.10x0.06";

/// Objects of other kinds, with the tracker that suits them: who follows a curved one by flat faces
/// loses it.
const OTHERS: [(&str, Kind); 5] = [
    ("hexagon:0.045", Kind::Hypotheses),
    ("triangle:0.06", Kind::Hypotheses),
    ("lshape:0.09x0.09x0.035", Kind::Hypotheses),
    ("corners:-0.05x-0.03,0.045x-0.035,0.055x0.02,-0.03x0.04", Kind::Hypotheses),
    ("ellipse:0.10x0.06", Kind::Automatic),
];

/// New candidates at every choice.
const CANDIDATES: usize = 120;

/// What an exploration is to know in the end.
///
/// ```
/// use tactile_host::experiment::exploration::Goal;
///
/// let goal: Goal = "strict+pose".parse()?;
/// assert!(goal.pose);
/// assert_eq!(goal.to_string(), "strict+pose");
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Of the shape.
    pub until: Until,
    /// Whether the last pose must be known, too: within 3 mm and 3° with 95 % by the explorer's own
    /// account.
    pub pose: bool,
}

impl FromStr for Goal {
    type Err = String;

    fn from_str(text: &str) -> Result<Goal, String> {
        let (shape, pose) = text.strip_suffix("+pose").map_or((text, false), |shape| (shape, true));
        let until = match shape {
            "strict" => Until::Strict,
            "lenient" => Until::Lenient,
            _ => {
                return Err(format!(
                    "expected strict, lenient, strict+pose or lenient+pose, found {text:?}"
                ));
            }
        };
        Ok(Goal { until, pose })
    }
}

impl fmt::Display for Goal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.until, if self.pose { "+pose" } else { "" })
    }
}

/// Among what a row's hand chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Among {
    /// The same ten grasps every time, as in the thesis
    Fixed,
    /// 120 new ones at every choice
    Continuous,
}

impl Among {
    /// As on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Among::Fixed => "fixed",
            Among::Continuous => "continuous",
        }
    }

    pub(super) fn candidates(self) -> Candidates {
        match self {
            Among::Fixed => Candidates::Fixed,
            Among::Continuous => Candidates::Continuous(CANDIDATES),
        }
    }
}

/// Which rows of a table to make; what is empty leaves it to the table.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    /// Objects, each by all criteria; otherwise the rectangle by all and others by chance and the best.
    pub objects: Vec<String>,
    /// Who follows what moves; otherwise whoever suits the object, and for the rectangle the thesis'
    /// particle filter besides.
    pub trackers: Vec<Kind>,
    /// What corrects the tracker's poses; otherwise the joint graph, and nothing after the thesis'
    /// filter.
    pub graph: Option<graph::Kind>,
    /// What decides, of all criteria there are.
    pub criteria: Vec<Criterion>,
    /// Among what.
    pub among: Vec<Among>,
    /// What is to be known.
    pub goals: Vec<Goal>,
}

/// A case of a table.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Case {
    pub object: ObjectSpec,
    pub tracker: Option<Kind>,
    pub graph: graph::Kind,
    pub criterion: Criterion,
    pub among: Among,
    pub goal: Goal,
}

/// The cases that are asked for, in the table's order. Combinations that make no sense are left out: a
/// drawn candidate never repeats, and nobody asks for the pose of what stays where it is.
pub(super) fn cases(of: TableOf, selection: &Selection) -> Result<Vec<Case>, ObjectError> {
    use Criterion::*;
    let moving = of == TableOf::Moving;
    let (criteria, few): (&[Criterion], &[Criterion]) = if moving {
        (&[Random, NoRepeat, DetSigma, Kl, Entropy, Information, Both], &[Random, Both])
    } else {
        (&[Random, NoRepeat, VarianceSum, Igef, Entropy, Information], &[Random, Information])
    };
    let (shape, pose) =
        ([goal(false, false), goal(true, false)], [goal(false, true), goal(true, true)]);
    let all = [shape, pose].concat();
    let goals = |usual: &[Goal]| -> Vec<Goal> {
        let asked = if selection.goals.is_empty() { usual } else { &selection.goals };
        asked.iter().copied().filter(|g| moving || !g.pose).collect()
    };
    let among = |usual: &[Among]| or(&selection.among, usual);
    const BOTH: [Among; 2] = [Among::Fixed, Among::Continuous];
    let mut cases = Vec::new();
    let mut add =
        |name: &str, kind: Kind, criteria: &[Criterion], usual: &[Goal], ways: &[Among]| {
            let object: ObjectSpec = name.parse()?;
            let trackers = match moving {
                true => or(&selection.trackers, &[kind]).into_iter().map(Some).collect(),
                false => vec![None],
            };
            for &tracker in &trackers {
                let graph = selection.graph.unwrap_or(match tracker {
                    None | Some(Kind::Bootstrap) => graph::Kind::None,
                    Some(_) => graph::Kind::Planes,
                });
                for goal in goals(usual) {
                    for among in among(ways) {
                        for criterion in or(&selection.criteria, criteria) {
                            if (criterion, among) != (NoRepeat, Among::Continuous) {
                                let object = object.clone();
                                cases.push(Case { object, tracker, graph, criterion, among, goal });
                            }
                        }
                    }
                }
            }
            Ok::<(), ObjectError>(())
        };
    for name in &selection.objects {
        add(name, suits(name), criteria, if moving { &all } else { &shape }, &BOTH)?;
    }
    if !selection.objects.is_empty() {
        return Ok(cases);
    }
    add(RECTANGLE, Kind::Hypotheses, criteria, if moving { &all } else { &shape }, &BOTH)?;
    let own = selection.trackers.is_empty() && selection.criteria.is_empty();
    if moving && own {
        // The thesis' setting: its tracker, its criteria, its ten grasps.
        add(RECTANGLE, Kind::Bootstrap, &[Random, DetSigma, Kl], &shape, &[Among::Fixed])?;
    }
    for (name, kind) in OTHERS {
        add(name, kind, few, if moving { &pose } else { &shape }, &BOTH)?;
    }
    Ok(cases)
}

fn goal(strict: bool, pose: bool) -> Goal {
    Goal { until: if strict { Until::Strict } else { Until::Lenient }, pose }
}

/// What was asked for, else the usual.
fn or<T: Copy>(asked: &[T], usual: &[T]) -> Vec<T> {
    if asked.is_empty() { usual.to_vec() } else { asked.to_vec() }
}

/// Who follows an object of this name.
fn suits(name: &str) -> Kind {
    let known = OTHERS.iter().chain(&[(RECTANGLE, Kind::Hypotheses)]).find(|(other, _)| {
        let [a, b] = [name, other].map(|text| text.parse::<ObjectSpec>().ok());
        a.is_some() && a == b
    });
    known.map_or(Kind::Automatic, |(_, kind)| *kind)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(of: TableOf, selection: &Selection) -> usize {
        cases(of, selection).unwrap().len()
    }

    #[test]
    fn parts_of_a_table_make_the_whole() {
        for of in [TableOf::Fixed, TableOf::Moving] {
            let whole =
                Selection { objects: vec!["rectangle:0.1x0.06".into()], ..Default::default() };
            let all = cases(of, &whole).unwrap();
            let mut parts = Vec::new();
            for goal in ["lenient", "strict", "lenient+pose", "strict+pose"] {
                for among in [Among::Fixed, Among::Continuous] {
                    let goals = vec![goal.parse().unwrap()];
                    let part = Selection { goals, among: vec![among], ..whole.clone() };
                    parts.extend(cases(of, &part).unwrap());
                }
            }
            assert_eq!(all, parts, "{of:?}");
            assert!(all.iter().all(|c| c.tracker.is_some() == (of == TableOf::Moving)));
            assert!(all.iter().all(|c| of == TableOf::Moving || !c.goal.pose));
        }
    }

    #[test]
    fn what_is_asked_for_is_what_is_run() {
        let one = Selection {
            objects: vec!["ellipse:0.1x0.06".into()],
            criteria: vec![Criterion::Igef],
            among: vec![Among::Continuous],
            goals: vec!["strict+pose".parse().unwrap()],
            ..Default::default()
        };
        let [case] = &cases(TableOf::Moving, &one).unwrap()[..] else { panic!() };
        assert_eq!(case.tracker, Some(Kind::Automatic), "a curved object, however it is written");
        assert_eq!((case.criterion, case.among), (Criterion::Igef, Among::Continuous));
        // The pose of what stays is not asked for.
        assert_eq!(count(TableOf::Fixed, &one), 0);
        let theirs = Selection { trackers: vec![Kind::Bootstrap], ..one };
        let [case] = &cases(TableOf::Moving, &theirs).unwrap()[..] else { panic!() };
        assert_eq!(case.tracker, Some(Kind::Bootstrap));
    }

    #[test]
    fn the_thesis_own_setting_has_rows() {
        let all = cases(TableOf::Moving, &Selection::default()).unwrap();
        let theirs: Vec<_> = all.iter().filter(|c| c.tracker == Some(Kind::Bootstrap)).collect();
        assert_eq!(theirs.len(), 6);
        assert!(theirs.iter().all(|c| c.among == Among::Fixed && !c.goal.pose));
        assert!(theirs.iter().all(|c| c.graph == graph::Kind::None));
        let plain = Selection { graph: Some(graph::Kind::None), ..Selection::default() };
        assert!(
            cases(TableOf::Moving, &plain).unwrap().iter().all(|c| c.graph == graph::Kind::None)
        );
        for text in ["strictly", "+pose", "pose", "", "strict+", "gain:1"] {
            assert!(text.parse::<Goal>().unwrap_err().contains("strict+pose"), "{text}");
        }
    }

    #[test]
    fn objects_that_are_none_are_errors() {
        let none = Selection { objects: vec!["cheese:1".into()], ..Default::default() };
        assert!(cases(TableOf::Fixed, &none).is_err());
    }
}
