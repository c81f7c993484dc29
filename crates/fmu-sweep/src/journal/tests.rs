use super::*;
use crate::{Column, Kind, Value};

const RUNS: u64 = 4;

fn columns() -> Columns {
    let column = |name: &str, kind| Column {
        name: name.into(),
        kind,
        optional: true,
    };
    Columns::new([column("p", Kind::Number), column("model", Kind::Text)]).unwrap()
}

fn row(index: u64) -> Row {
    let number = if index == 1 {
        f64::NAN
    } else {
        index as f64 / 10.0
    };
    let text = ["", "π,\"x\"", "linear", "#"][index as usize];
    Row {
        index,
        cells: vec![
            Some(Value::Number(number)),
            (index > 0).then(|| Value::Text(text.into())),
        ],
    }
}

fn open(output: &Path) -> Result<Journal, Error> {
    Journal::open(output, "0abc", columns(), RUNS)
}

/// A folder, and the paths of the table and the journal in it.
fn files() -> (tempfile::TempDir, PathBuf, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("a.csv");
    let part = folder.path().join("a.csv.part");
    (folder, output, part)
}

const TABLE: &str = "index,p,model\n0,0.0,\n1,NaN,\"π,\"\"x\"\"\"\n2,0.2,linear\n3,0.3,#\n";

#[test]
fn rows_are_stored_in_the_documented_format_and_sorted_at_the_end() {
    let (folder, output, part) = files();
    let journal = open(&output).unwrap();
    assert!(journal.done().is_empty());
    for index in [2, 0] {
        journal.append(&row(index)).unwrap();
    }
    journal.sync().unwrap();
    let expected = "# sweep 0abc\nindex,p,model\n2,0.2,linear\n0,0.0,\n";
    assert_eq!(fs::read_to_string(&part).unwrap(), expected);
    drop(journal);

    let journal = open(&output).unwrap();
    assert_eq!(Vec::from_iter(journal.done()), [&0, &2]);
    assert_eq!(Vec::from_iter(journal.pending(0..RUNS)), [1, 3]);
    assert_eq!(Vec::from_iter(journal.pending(0..3)), [1]);
    for index in [3, 1] {
        journal.append(&row(index)).unwrap();
    }
    journal.finish().unwrap();
    assert_eq!(fs::read_to_string(&output).unwrap(), TABLE);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn a_journal_torn_at_any_byte_is_resumed() {
    let (_folder, output, part) = files();
    let journal = open(&output).unwrap();
    for index in [2, 1, 0, 3] {
        journal.append(&row(index)).unwrap();
    }
    drop(journal);
    let whole = fs::read(&part).unwrap();
    for cut in 0..=whole.len() {
        fs::write(&part, &whole[..cut]).unwrap();
        let journal = open(&output).unwrap();
        let lines = whole[..cut].iter().filter(|&&byte| byte == b'\n').count();
        assert_eq!(
            journal.done().len(),
            lines.saturating_sub(2),
            "cut at {cut}"
        );
        for index in journal.pending(0..RUNS) {
            journal.append(&row(index)).unwrap();
        }
        assert_eq!(fs::read(&part).unwrap().len(), whole.len(), "cut at {cut}");
        journal.finish().unwrap();
        assert_eq!(fs::read_to_string(&output).unwrap(), TABLE, "cut at {cut}");
    }
}

#[test]
fn two_processes_cannot_share_a_journal() {
    let (_folder, output, part) = files();
    let journal = open(&output).unwrap();
    let expected = format!(
        "{} is in use by another process: wait for it, or give another --out",
        part.display()
    );
    assert_eq!(open(&output).unwrap_err().to_string(), expected);
    drop(journal);
    open(&output).unwrap();
}

#[test]
fn the_journal_of_another_sweep_is_not_changed() {
    let (_folder, output, part) = files();
    drop(open(&output).unwrap());
    let before = fs::read(&part).unwrap();
    let expected = format!(
        "{} belongs to another sweep: delete it or give another --out",
        part.display()
    );
    let mut other = columns().iter().cloned().collect::<Vec<_>>();
    other.pop();
    let other = Columns::new(other).unwrap();
    for (fingerprint, columns) in [("0abd", columns()), ("0abc0", columns()), ("0abc", other)] {
        let error = Journal::open(&output, fingerprint, columns, RUNS).unwrap_err();
        assert_eq!(error.to_string(), expected);
        assert_eq!(fs::read(&part).unwrap(), before);
    }
    for text in ["an unrelated file", "\n", "# sweep 0abc\n\n"] {
        fs::write(&part, text).unwrap();
        assert_eq!(open(&output).unwrap_err().to_string(), expected);
        assert_eq!(fs::read_to_string(&part).unwrap(), text);
    }
}

#[test]
fn a_duplicate_run_is_kept_once_if_its_rows_are_equal() {
    let (_folder, output, _) = files();
    let journal = open(&output).unwrap();
    for index in [1, 0, 1, 2, 3, 1] {
        journal.append(&row(index)).unwrap();
    }
    drop(journal);
    let journal = open(&output).unwrap();
    assert_eq!(journal.done().len(), 4);
    journal.finish().unwrap();
    assert_eq!(fs::read_to_string(&output).unwrap(), TABLE);
}

#[test]
fn a_damaged_journal_is_rejected_with_the_line() {
    let (_folder, output, part) = files();
    drop(open(&output).unwrap());
    let header = fs::read_to_string(&part).unwrap();
    for (lines, reason) in [
        ("0,0.1,\n\n1,0.1,\n", ":4: \"\", expected 3 fields"),
        (
            "0,0.1,\n0,0.2,\n",
            ":4: another row of run 0, expected the same one",
        ),
        ("x,0.1,\n", ":3: \"x,0.1,\", expected the number of a run"),
        ("0,0.1\n", ":3: \"0,0.1\", expected 3 fields"),
        (
            "0,0.\u{0}1,\n",
            ":3: run 0: p is 0.\u{0}1, expected a number",
        ),
        ("0,0.1,\"a\n", ":3: \"0,0.1,\\\"a\", expected fields of CSV"),
        ("4,0.1,\n", ":3: run 4, expected one of 0..4"),
    ] {
        let text = format!("{header}{lines}");
        fs::write(&part, &text).unwrap();
        let error = open(&output).unwrap_err().to_string();
        let advice = "delete the line to repeat the run";
        assert_eq!(error, format!("{}{reason}; {advice}", part.display()));
        assert_eq!(fs::read_to_string(&part).unwrap(), text);
    }
    fs::write(&part, [header.as_bytes(), b"0,0.1,\xff\n"].concat()).unwrap();
    let error = open(&output).unwrap_err().to_string();
    assert!(
        error.starts_with(&format!("cannot read {}: ", part.display())),
        "{error}"
    );
}

#[test]
fn a_journal_with_missing_runs_is_not_finished() {
    let (_folder, output, part) = files();
    let journal = open(&output).unwrap();
    for index in [0, 3] {
        journal.append(&row(index)).unwrap();
    }
    let expected = format!(
        "{}: 2 of 4 runs are missing, the first is 1",
        part.display()
    );
    assert_eq!(journal.finish().unwrap_err().to_string(), expected);
    assert_eq!(open(&output).unwrap().done().len(), 2);
    assert!(!output.exists());
}

#[test]
fn a_row_that_does_not_fit_is_not_stored() {
    let (_folder, output, part) = files();
    let journal = open(&output).unwrap();
    let before = fs::read(&part).unwrap();
    let mut short = row(0);
    short.cells.pop();
    let mut late = row(0);
    late.index = 4;
    for (row, reason) in [
        (short, "run 0: a row of 1 values, expected 2"),
        (late, "run 4, expected one of 0..4"),
    ] {
        assert_eq!(journal.append(&row).unwrap_err().to_string(), reason);
    }
    assert_eq!(fs::read(&part).unwrap(), before);
}

#[test]
fn wrong_arguments_are_rejected_before_a_file_is_created() {
    let (folder, output, _) = files();
    for fingerprint in ["", "xyz", "0a\n", "0a 0b"] {
        let error = Journal::open(&output, fingerprint, columns(), RUNS).unwrap_err();
        let expected = format!("the fingerprint is {fingerprint:?}, expected hexadecimal digits");
        assert_eq!(error.to_string(), expected);
    }
    assert!(open(&folder.path().join("a.txt")).is_err());
    let nowhere = folder.path().join("nowhere/a.csv");
    let error = open(&nowhere).unwrap_err().to_string();
    assert!(error.ends_with("nowhere does not exist"), "{error}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn threads_append_whole_rows() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("a.parquet");
    let journal = Journal::open(&output, "0abc", columns(), 4000).unwrap();
    std::thread::scope(|scope| {
        for thread in 0..4 {
            let journal = &journal;
            scope.spawn(move || {
                for k in 0..1000 {
                    let mut row = row(thread);
                    row.index = 1000 * thread + k;
                    journal.append(&row).unwrap();
                }
            });
        }
    });
    journal.finish().unwrap();
    assert!(output.exists());
}
