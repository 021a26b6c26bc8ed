//! Tables of contacts: one row per contact, columns found by their names.

use std::path::Path;

use serde_json::{Map, Value, json};

use super::super::{
    GraspLog, LogError, LoggedContact, LoggedGrasp, MAX_CONTACTS, MAX_COORDINATE, MAX_FINGERS,
    words,
};
use super::{Options, text, too_many};
use crate::space::Point;

/// Reads a table with the columns `x,y[,z][,nx,ny[,nz]][,grasp][,finger][,force]` in any order,
/// separated by commas, semicolons or tabs (whichever the first line has). With `z` it is spatial.
/// Rows of one grasp stand together and grasp numbers ascend; without a `grasp` column all rows are
/// one grasp. Empty cells are allowed where the column is optional, a normal is given whole or not
/// at all. Columns of other names are kept with the contact, but none may be called like a field that
/// a log's contact has anyway: `point`, `normal`, `normal_noise` or `sensor`. Lines that start with `#`
/// are skipped.
///
/// # Errors
/// Naming the file, line and column and what was expected there.
pub fn import(path: &Path, options: &Options) -> Result<GraspLog, LogError> {
    parse(&text(path)?, path, options)
}

/// Fields of a contact that no cell can hold: kept as a column of another name, they would be read as
/// what they are not.
const FIELDS: [&str; 4] = ["point", "normal", "normal_noise", words::CONTACT];

/// Where errors are.
struct Row<'a> {
    file: &'a Path,
    line: usize,
    cells: Vec<&'a str>,
}

impl Row<'_> {
    fn wrong(&self, column: Option<&str>, problem: impl std::fmt::Display) -> LogError {
        let problem = match column {
            Some(name) => format!("column `{name}`: {problem}"),
            None => problem.to_string(),
        };
        LogError::Line { file: self.file.into(), line: self.line, problem }
    }

    /// The number in the column, `None` where the cell is empty.
    fn number(&self, column: usize, name: &str) -> Result<Option<f64>, LogError> {
        match self.cells[column] {
            "" => Ok(None),
            cell => match cell.parse::<f64>() {
                Ok(x) if x.is_finite() => Ok(Some(x)),
                _ => {
                    let problem = format!("expected a finite number, found {cell:?}");
                    Err(self.wrong(Some(name), problem))
                }
            },
        }
    }
}

/// The columns that mean something, by their place in the row.
struct Columns {
    /// In small letters, and as they are.
    names: Vec<String>,
    titles: Vec<String>,
    point: Vec<usize>,
    normal: Vec<usize>,
    grasp: Option<usize>,
    finger: Option<usize>,
    force: Option<usize>,
    other: Vec<usize>,
}

/// What a cell that nobody knows holds: a number where that says the same, neither 0012 nor more digits than it
/// has.
fn kept(cell: &str) -> Value {
    if let Ok(whole) = cell.parse::<i64>()
        && whole.to_string() == cell
    {
        return json!(whole);
    }
    let digits = cell.bytes().take_while(|b| !matches!(b, b'e' | b'E'));
    let precise = digits.filter(u8::is_ascii_digit).count() <= 15;
    let unsigned = cell.trim_start_matches(['+', '-']).as_bytes();
    let padded = matches!(unsigned, [b'0', b'0'..=b'9', ..]);
    let number = cell.parse::<f64>().ok().filter(|x| x.is_finite() && precise && !padded);
    number.map_or_else(|| json!(cell), |x| json!(x))
}

impl Columns {
    fn new(header: &Row<'_>) -> Result<Columns, LogError> {
        let names: Vec<String> = header.cells.iter().map(|c| c.to_ascii_lowercase()).collect();
        for (i, name) in names.iter().enumerate() {
            // A line of numbers is no header at all.
            if names[..i].contains(name) && name.parse::<f64>().is_err() {
                return Err(header.wrong(Some(name), "is there twice"));
            }
            if FIELDS.contains(&name.as_str()) {
                let problem = "expected another name, as a log's contacts have a field of this one";
                return Err(header.wrong(Some(name), problem));
            }
        }
        let find = |name: &str| names.iter().position(|n| n == name);
        let needed = |name: &'static str, why: &str| {
            find(name).ok_or_else(|| {
                let found = names.join(", ");
                header.wrong(None, format!("expected a column `{name}`{why}, found {found}"))
            })
        };
        let mut point = vec![needed("x", "")?, needed("y", "")?];
        point.extend(find("z"));
        let mut normal = Vec::new();
        if ["nx", "ny", "nz"].iter().any(|name| find(name).is_some()) {
            normal = vec![needed("nx", " beside the other normals")?];
            normal.push(needed("ny", " beside the other normals")?);
            if point.len() == 3 {
                normal.push(needed("nz", " beside the other normals")?);
            } else if find("nz").is_some() {
                return Err(header.wrong(Some("nz"), "expected none, as there is no column `z`"));
            }
        }
        let [grasp, finger, force] = ["grasp", "finger", "force"].map(find);
        let known = |i: &usize| {
            point.contains(i) || normal.contains(i) || [grasp, finger, force].contains(&Some(*i))
        };
        let other = (0..names.len()).filter(|i| !known(i) && !names[*i].is_empty()).collect();
        let titles = header.cells.iter().map(|c| c.to_string()).collect();
        Ok(Columns { point, normal, grasp, finger, force, other, names, titles })
    }

    fn position(&self, row: &Row<'_>, unit: f64) -> Result<Point, LogError> {
        let mut point = Point::zeros();
        for (x, column) in point.iter_mut().zip(&self.point) {
            let name = &self.names[*column];
            let value = row.number(*column, name)?;
            *x = unit * value.ok_or_else(|| row.wrong(Some(name), "expected a number"))?;
            if x.abs() > MAX_COORDINATE {
                let problem = format!("expected a coordinate within ±{MAX_COORDINATE} m");
                return Err(row.wrong(Some(name), problem));
            }
        }
        Ok(point)
    }

    fn normal(&self, row: &Row<'_>) -> Result<Option<Point>, LogError> {
        let mut normal = Point::zeros();
        let mut filled = 0;
        for (x, column) in normal.iter_mut().zip(&self.normal) {
            if let Some(value) = row.number(*column, &self.names[*column])? {
                *x = value;
                filled += 1;
            }
        }
        if filled == 0 {
            return Ok(None);
        }
        if filled < self.normal.len() {
            return Err(row.wrong(None, "expected a whole normal or none, found a part of one"));
        }
        let length = normal.norm();
        if (length - 1.0).abs() > 1e-3 {
            let problem = format!("expected a normal of length 1 within 0.001, found {length}");
            return Err(row.wrong(Some("nx"), problem));
        }
        Ok(Some(normal / length))
    }
}

fn parse(text: &str, path: &Path, options: &Options) -> Result<GraspLog, LogError> {
    let rows = text.trim_start_matches('\u{feff}').lines().enumerate();
    let mut rows =
        rows.filter(|(_, line)| !line.trim().is_empty() && !line.trim_start().starts_with('#'));
    let empty = || LogError::Content {
        file: path.into(),
        problem: "is empty; expected a line of column names and one line per contact".into(),
    };
    let (index, line) = rows.next().ok_or_else(empty)?;
    let separator = [',', ';', '\t'].into_iter().find(|c| line.contains(*c)).unwrap_or(',');
    let header = split(path, index, line, separator);
    let columns = Columns::new(&header)?;
    let mut fingers: Vec<String> = Vec::new();
    let mut grasps: Vec<LoggedGrasp> = Vec::new();
    for (index, line) in rows {
        let row = split(path, index, line, separator);
        if row.cells.len() != columns.names.len() {
            let (expected, found) = (columns.names.len(), row.cells.len());
            let problem = format!("expected {expected} cells as in the first line, found {found}");
            return Err(row.wrong(None, problem));
        }
        let number = match columns.grasp.map(|c| row.cells[c]) {
            None => 0,
            Some(cell) => cell.parse::<u64>().map_err(|_| {
                let problem = format!("expected a grasp number 0, 1, …, found {cell:?}");
                row.wrong(Some("grasp"), problem)
            })?,
        };
        let mut finger = None;
        if let Some(name) = columns.finger.map(|c| row.cells[c]).filter(|name| !name.is_empty()) {
            finger = Some(fingers.iter().position(|f| f == name).unwrap_or_else(|| {
                fingers.push(name.to_string());
                fingers.len() - 1
            }));
            if fingers.len() > MAX_FINGERS {
                let problem = format!("expected at most {MAX_FINGERS} different fingers");
                return Err(row.wrong(Some("finger"), problem));
            }
        }
        let force = columns.force.map(|c| row.number(c, "force")).transpose()?.flatten();
        let other = columns.other.iter().filter(|c| !row.cells[**c].is_empty());
        let unknown: Map<String, Value> =
            other.map(|c| (columns.titles[*c].clone(), kept(row.cells[*c]))).collect();
        let contact = LoggedContact {
            finger,
            point: columns.position(&row, options.unit)?,
            normal: columns.normal(&row)?,
            normal_noise: None,
            force,
            unknown,
        };
        match grasps.last_mut() {
            Some(last) if last.index == number => {
                last.contacts.push(contact);
                if last.contacts.len() > MAX_CONTACTS {
                    let problem = too_many(last.contacts.len());
                    return Err(row.wrong(None, format!("{problem}; number them in `grasp`")));
                }
            }
            Some(last) if last.index > number => {
                let problem = format!("expected at least {}, as in the row before", last.index);
                return Err(row.wrong(Some("grasp"), format!("{problem}, found {number}")));
            }
            _ => grasps.push(LoggedGrasp {
                index: number,
                contacts: vec![contact],
                ..LoggedGrasp::default()
            }),
        }
    }
    if grasps.is_empty() {
        return Err(header.wrong(None, "expected one line per contact below the column names"));
    }
    Ok(options.log(columns.point.len(), fingers, grasps))
}

fn split<'a>(file: &'a Path, index: usize, line: &'a str, separator: char) -> Row<'a> {
    let mut cells = Vec::new();
    let mut rest = Some(line);
    while let Some(line) = rest {
        let (cell, after) = quoted(line, separator).unwrap_or_else(|| plain(line, separator));
        cells.push(cell);
        rest = after;
    }
    Row { file, line: index + 1, cells }
}

/// The first cell of a line, and what is behind the separator after it.
fn plain(line: &str, separator: char) -> (&str, Option<&str>) {
    let both = line.split_once(separator);
    both.map_or((line.trim(), None), |(cell, rest)| (cell.trim(), Some(rest)))
}

/// The same of a cell in quotes, between which there may be separators; `None` where it is not.
fn quoted(line: &str, separator: char) -> Option<(&str, Option<&str>)> {
    let (cell, rest) = line.trim_start().strip_prefix('"')?.split_once('"')?;
    let rest = rest.trim_start_matches(|c: char| c.is_whitespace() && c != separator);
    match rest.strip_prefix(separator) {
        Some(rest) => Some((cell, Some(rest))),
        None => rest.is_empty().then_some((cell, None)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::Noise;
    use crate::quantity::Deviation;

    fn csv(text: &str) -> Result<GraspLog, LogError> {
        parse(text, Path::new("some.csv"), &Options::default())
    }

    #[test]
    fn what_nobody_knows_is_kept_as_it_is() {
        for text in ["0012", "1712345678901234567.5", "left", "-00.5"] {
            assert_eq!(kept(text), json!(text));
        }
        assert_eq!(kept("1712345678901234567"), json!(1_712_345_678_901_234_567_i64));
        assert_eq!((kept("-0.5"), kept("1e5"), kept("0")), (json!(-0.5), json!(1e5), json!(0)));
    }

    #[test]
    fn separators_in_quotes_separate_nothing() {
        let cells = |line| split(Path::new("some.csv"), 0, line, ',').cells;
        assert_eq!(cells(r#"1, 2,"left, top" ,"","#), ["1", "2", "left, top", "", ""]);
        assert_eq!(cells(r#""a","b,c""#), ["a", "b,c"]);
        // Inches, and quotes that are not closed.
        assert_eq!(cells(r#"5" tip,"a"b,"c"#), [r#"5" tip"#, r#""a"b"#, r#""c"#]);
        assert_eq!(cells(""), [""]);
        let log = csv("x,y,note\n0.1,0.2,\"left, top\"\n").unwrap();
        assert_eq!(log.grasps[0].contacts[0].unknown["note"], json!("left, top"));
    }

    #[test]
    fn columns_are_found_by_name() {
        let log = csv("# made by hand\n\"Finger\",force, y,x,grasp,ny,nx,patch\nth,1.5,2,1,3,0.8,0.6,7\n,,4,3,3,,,\nff,,6,5,8,-1,0,skin\n")
            .unwrap();
        assert_eq!((log.dimension, &log.fingers[..]), (2, &["th".to_string(), "ff".into()][..]));
        assert_eq!(log.grasps.iter().map(|g| g.index).collect::<Vec<_>>(), [3, 8]);
        let [first, second] = &log.grasps[0].contacts[..] else { panic!() };
        assert_eq!((first.finger, first.force), (Some(0), Some(1.5)));
        assert_eq!(first.point, Point::new(1.0, 2.0, 0.0));
        assert_eq!(first.normal, Some(Point::new(0.6, 0.8, 0.0)));
        assert_eq!(first.unknown["patch"], json!(7));
        assert_eq!((second.finger, second.force, second.normal), (None, None, None));
        assert_eq!(log.grasps[1].contacts[0].unknown["patch"], json!("skin"));
        assert_eq!(log.grasps[1].motion, None, "a table does not say how the object moved");
    }

    #[test]
    fn units_noise_and_fixed_objects() {
        let options = Options {
            unit: 1e-3,
            contact_noise: Some(Deviation { length: 0.001, angle: 0.0 }),
            fixed: true,
            ..Options::default()
        };
        let log = parse("x;y;z;grasp\n1;2;3;0\n4;5;6;1", Path::new("x"), &options).unwrap();
        // What has no errors is said to have the least that models take, what nobody said is left open.
        let least = Noise {
            point: Some(0.001),
            normal: Some(Noise::LEAST_NORMAL),
            translation: Some(Noise::LEAST_TRANSLATION),
            rotation: Some(Noise::LEAST_ROTATION),
        };
        assert_eq!((log.dimension, log.noise), (3, least));
        assert_eq!(log.grasps[1].contacts[0].point, Point::new(4e-3, 5e-3, 6e-3));
        let identity = Some(crate::space::Pose::identity());
        assert_eq!((log.grasps[0].motion, log.grasps[1].motion), (None, identity));
        assert_eq!(log.grasps[0].truth, identity);
    }

    #[test]
    fn wrong_tables_are_refused_with_their_place() {
        let refused = |text: &str, expected: &str| {
            let error = csv(text).unwrap_err().to_string();
            assert!(error.starts_with("some.csv") && error.contains(expected), "{error}");
        };
        refused("", "is empty; expected a line of column names");
        refused("x,y\n", "line 1: expected one line per contact");
        refused("x,z\n1,2\n", "line 1: expected a column `y`, found x, z");
        refused("1,2\n3,4\n", "expected a column `x`");
        refused("0,0\n3,4\n", "expected a column `x`, found 0, 0");
        refused("x,y,x\n", "line 1: column `x`: is there twice");
        for name in ["point", "Normal", "normal_noise", "sensor"] {
            let named = format!("line 2: column `{}`: expected another", name.to_lowercase());
            refused(&format!("# forces\nx,y,{name}\n1,2,3\n"), &named);
        }
        refused("x,y,nx\n", "expected a column `ny` beside the other normals");
        refused("x,y,nx,ny,nz\n", "column `nz`: expected none, as there is no column `z`");
        refused("x,y\n1,2\n3\n", "line 3: expected 2 cells as in the first line, found 1");
        refused("x,y\n1,abc\n", "line 2: column `y`: expected a finite number, found \"abc\"");
        refused("x,y\n1,NaN\n", "line 2: column `y`: expected a finite number, found \"NaN\"");
        refused("x,y\n1,\n", "line 2: column `y`: expected a number");
        refused("x,y\n1,1e9\n", "line 2: column `y`: expected a coordinate within ±10000 m");
        refused("x,y,nx,ny\n1,2,3,4\n", "expected a normal of length 1 within 0.001, found 5");
        refused("x,y,nx,ny\n1,2,0,0\n", "expected a normal of length 1 within 0.001, found 0");
        refused("x,y,nx,ny\n1,2,1,\n", "expected a whole normal or none");
        refused("x,y,grasp\n1,2,-1\n", "column `grasp`: expected a grasp number 0, 1, …");
        refused("x,y,grasp\n1,2,4\n1,2,3\n", "line 3: column `grasp`: expected at least 4");
        refused(&format!("x,y\n{}", "1,2\n".repeat(2000)), "line 1026: expected at most 1024");
        let fingers: String = (0..300).map(|i| format!("1,2,f{i}\n")).collect();
        refused(&format!("x,y,finger\n{fingers}"), "line 257: column `finger`: expected at most");
    }
}
