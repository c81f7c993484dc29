use std::fs::{self, File};

use ::parquet::file::reader::{FileReader, SerializedFileReader};
use ::parquet::record::Field;

use super::*;
use crate::{Cell, Column, Kind, Value};

fn columns() -> Columns {
    let column = |name: &str, kind, optional| Column {
        name: name.into(),
        kind,
        optional,
    };
    Columns::new([
        column("plant.M", Kind::Number, false),
        column("plant.model", Kind::Text, false),
        column("settling_time", Kind::Number, true),
        column("diverged", Kind::Boolean, false),
        column("remark", Kind::Text, true),
        column("flag", Kind::Boolean, true),
    ])
    .unwrap()
}

fn rows(count: u64) -> impl Iterator<Item = Result<Row, Error>> {
    (0..count).map(|index| {
        let number = index as f64 / 3.0;
        let third = index % 3 == 0;
        Ok(Row {
            index,
            cells: vec![
                Some(Value::Number(number)),
                Some(Value::Text(
                    ["linear", "non,linear"][index as usize % 2].into(),
                )),
                third.then_some(Value::Number(-number)),
                Some(Value::Boolean(third)),
                (!third).then_some(Value::Text(if index == 1 { "" } else { "π" }.into())),
                third.then_some(Value::Boolean(index % 2 == 0)),
            ],
        })
    })
}

#[test]
fn a_csv_file_has_a_header_and_a_line_for_each_row() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.csv");
    write(&file, &columns(), rows(3)).unwrap();
    assert_eq!(
        fs::read_to_string(&file).unwrap(),
        "index,plant.M,plant.model,settling_time,diverged,remark,flag\n\
         0,0.0,linear,-0.0,true,,true\n\
         1,0.3333333333333333,\"non,linear\",,false,\"\",\n\
         2,0.6666666666666666,linear,,false,π,\n"
    );
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

/// More rows than fit in one group.
#[test]
fn a_parquet_file_is_read_back_with_its_types() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.parquet");
    let count = (1 << 16) + 10;
    write(&file, &columns(), rows(count)).unwrap();
    let reader = SerializedFileReader::new(File::open(&file).unwrap()).unwrap();
    assert_eq!(reader.num_row_groups(), 2);
    let schema = reader.metadata().file_metadata().schema();
    let mut shown = Vec::new();
    ::parquet::schema::printer::print_schema(&mut shown, schema);
    assert_eq!(
        String::from_utf8(shown).unwrap(),
        "message sweep {
  REQUIRED INT64 index;
  REQUIRED DOUBLE plant.M;
  REQUIRED BYTE_ARRAY plant.model (STRING);
  OPTIONAL DOUBLE settling_time;
  REQUIRED BOOLEAN diverged;
  OPTIONAL BYTE_ARRAY remark (STRING);
  OPTIONAL BOOLEAN flag;
}
"
    );
    let mut read = reader.get_row_iter(None).unwrap();
    for row in rows(count) {
        let row = row.unwrap();
        let found = read.next().unwrap().unwrap();
        let fields: Vec<_> = found.get_column_iter().map(|(_, field)| field).collect();
        assert_eq!(fields[0], &Field::Long(row.index as i64));
        let cells: Vec<_> = fields[1..].iter().map(|field| cell(field)).collect();
        assert_eq!(cells, row.cells);
    }
    assert!(read.next().is_none());
}

fn cell(field: &Field) -> Cell {
    match field {
        Field::Null => None,
        Field::Double(number) => Some(Value::Number(*number)),
        Field::Bool(boolean) => Some(Value::Boolean(*boolean)),
        Field::Str(text) => Some(Value::Text(text.clone())),
        _ => panic!("{field:?}"),
    }
}

#[test]
fn the_same_rows_give_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    for extension in ["csv", "parquet"] {
        let [one, other] = ["one", "other"].map(|name| {
            let file = folder.path().join(name).with_extension(extension);
            write(&file, &columns(), rows(1000)).unwrap();
            fs::read(file).unwrap()
        });
        assert!(one == other, "{extension}");
    }
}

#[test]
fn a_failed_write_keeps_the_existing_file() {
    let folder = tempfile::tempdir().unwrap();
    for extension in ["csv", "parquet"] {
        let file = folder.path().join("a").with_extension(extension);
        fs::write(&file, "before").unwrap();
        let mut wrong = rows(1).next().unwrap().unwrap();
        wrong.cells[0] = None;
        let error = write(&file, &columns(), rows(3).chain([Ok(wrong)])).unwrap_err();
        assert_eq!(
            error.to_string(),
            "run 0: plant.M is empty, expected a number"
        );
        let broken = [Err(Error::new("broken"))];
        let error = write(&file, &columns(), rows(3).chain(broken)).unwrap_err();
        assert_eq!(error.to_string(), "broken");
        assert_eq!(fs::read_to_string(&file).unwrap(), "before");
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    let nowhere = folder.path().join("nowhere/a.csv");
    let error = write(&nowhere, &columns(), rows(1))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains(&nowhere.parent().unwrap().display().to_string()),
        "{error}"
    );
}

#[test]
fn other_extensions_are_rejected() {
    for name in ["a.txt", "a", ".csv", "a.CSV", "a.csv.gz", ""] {
        let reason = format!("{name}: expected a file named .csv or .parquet");
        assert_eq!(check(Path::new(name)).unwrap_err().to_string(), reason);
        let error = write(Path::new(name), &columns(), rows(1)).unwrap_err();
        assert_eq!(error.to_string(), reason);
    }
    let folder = tempfile::Builder::new().suffix(".csv").tempdir().unwrap();
    let error = check(folder.path()).unwrap_err().to_string();
    assert!(error.ends_with(" is a folder, expected a file"), "{error}");
}
