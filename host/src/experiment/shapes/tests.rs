use super::*;

fn selection(object: &str, contacts: usize) -> Selection {
    Selection {
        objects: vec![object.into()],
        contacts: vec![contacts],
        models: vec![],
        noise: Deviation { length: 1e-3, angle: 0.0873 },
        outliers: 0.0,
        seeds: 2,
        first_seed: 1000,
    }
}

#[test]
fn all_models_are_on_the_row_and_failures_are_counted() {
    let table = run(None, &selection("rectangle", 12), |_| {}).unwrap();
    assert_eq!(table.rows.len(), 1);
    let row = &table.rows[0];
    assert_eq!(row.cells.len(), MODELS.len());
    for name in ["auto", "gp", "superquadric", "Nagata", "occupancy", "cloud"] {
        let cell = row.cell(name).unwrap();
        assert_eq!(cell.runs, (2, 2), "{name}");
        assert_eq!(cell.auto_closer.of, 2, "{name}");
        let (hausdorff, mean) = (cell.hausdorff_mm.unwrap(), cell.mean_mm.unwrap());
        assert!(hausdorff.median > mean.median && mean.median > 0.0, "{name}");
    }
    assert_eq!(row.cell("auto").unwrap().auto_closer.successes, 0);
    assert_eq!(row.cell("cloud").unwrap().auto_closer.successes, 2);
    // Three contacts make neither a closed polytope nor a superquadric.
    let few = run(None, &selection("rectangle", 3), |_| {}).unwrap();
    let cell = few.rows[0].cell("superquadric").unwrap();
    assert_eq!((cell.runs, cell.hausdorff_mm), ((0, 2), None));
    assert!(few.to_string().contains("auto is not the best on"));
}

#[test]
fn a_rival_counts_only_where_it_gave_as_many_shapes() {
    let cell = |model, runs, median| Cell {
        model,
        runs: (runs, 4),
        hausdorff_mm: Spread::of([median]),
        mean_mm: None,
        rms_mm: None,
        auto_closer: Proportion { successes: 1, of: 4 },
    };
    let row = |auto, faces, faces_runs| Comparison {
        title: String::new(),
        rows: vec![Row {
            object: "thing".into(),
            contacts: 9,
            cells: vec![
                cell("auto", 4, auto),
                cell("faces", faces_runs, faces),
                cell("thesis SE", 4, 3.0),
            ],
            chosen: None,
            seconds: 0.0,
        }],
        overall: None,
        skipped: vec![],
    };
    assert!(row(2.0, 1.0, 3).beaten(|_| true).is_empty());
    let beaten = row(2.0, 1.0, 4).beaten(|_| true);
    assert_eq!(
        beaten,
        ["thing with 9: 2.00 mm, faces 1.00 mm; auto closer in 25 % [5, 70] of the runs"]
    );
    assert!(row(2.0, 1.0, 4).beaten(|n| n == "thesis SE").is_empty());
    assert_eq!(row(3.5, 4.0, 4).beaten(|n| n == "thesis SE").len(), 1);
}

#[test]
fn rows_are_summed_up_and_wild_contacts_cost_what_follows_all() {
    let clean = Selection {
        objects: vec!["rectangle:0.11x0.07".into(), "random:2,3".into()],
        models: vec![Model::SquaredExponential],
        seeds: 1,
        ..selection("", 30)
    };
    let table = run(None, &clean, |_| {}).unwrap();
    let overall = table.overall.as_ref().unwrap();
    assert_eq!((overall.object.as_str(), overall.contacts), ("all 2 rows", 60));
    let kernel = |row: &Row| row.cell("thesis SE").unwrap().hausdorff_mm.unwrap();
    let [a, b] = [0, 1].map(|i| kernel(&table.rows[i]).median);
    assert!((kernel(overall).median - (a + b) / 2.0).abs() < 1e-12);
    assert_eq!(overall.cell("thesis SE").unwrap().runs, (2, 2));
    let text = table.to_string();
    assert!(text.contains("their mean") && !text.contains("Nagata"), "{text}");
    assert_eq!(overall.cells.len(), 2);
    let wild = Selection { outliers: 0.1, ..clean };
    let spoilt = run(None, &wild, |_| {}).unwrap();
    assert!(spoilt.title.contains("10 % wild"));
    assert!(kernel(&spoilt.rows[0]).median > 2.0 * a, "{a}, then {:?}", kernel(&spoilt.rows[0]));
}

#[test]
fn models_are_named_as_options_are() {
    assert_eq!(model("thesis-se"), Ok(Model::SquaredExponential));
    let error = model("teapot").unwrap_err().to_string();
    assert!(error.starts_with("expected auto, gp, faces, thesis-se, thesis-tp"), "{error}");
}

#[test]
fn objects_are_found_by_part_of_their_name_or_made() {
    let names = |wanted: &[&str]| -> Vec<String> {
        let wanted: Vec<String> = wanted.iter().map(|w| w.to_string()).collect();
        cases(None, &wanted).unwrap().0.into_iter().map(|c| c.name).collect()
    };
    assert_eq!(names(&[]).len(), OBJECTS.len());
    assert_eq!(names(&["sphere", "rect"]), ["rectangle:0.12x0.06", "sphere:0.08"]);
    assert_eq!(names(&["ngon:5,0.04"]), ["ngon:5,0.04"]);
    assert!(cases(None, &["teapot".into()]).is_err());
    let (none, skipped) = cases(None, &["ycb".into()]).unwrap();
    assert!(none.is_empty() && skipped.len() == 1);
}
