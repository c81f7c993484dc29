//! Calibration files are read, and mistakes in them are named.

use control_blocks::{Table1, Table2};

fn error_of_3_points(text: &str) -> String {
    let mut table = Table1::<3> { y: [7.0; 3], ..Table1::default() };
    let error = table.read_csv("torque.csv", text).unwrap_err();
    assert_eq!(table.y, [7.0; 3], "a table that cannot be read does not change");
    error.to_string()
}

fn error_of_2_rows(text: &str) -> String {
    Table2::<2, 3>::default().read_csv("map.csv", text).unwrap_err().to_string()
}

#[test]
fn separators_headers_comments_and_line_ends_of_spreadsheets_are_read() {
    for text in [
        "0,5\n100,9\n300,1",
        "speed [rpm],torque\n0,5\n100,9\n300,1\n",
        "\u{feff}speed;torque\r\n0;5\r\n1e2;9\r\n300;1\r\n",
        "# measured on the bench\n\n0\t5.0\n# in the middle\n100\t+9\n 300 \t 1 \n\n",
    ] {
        let mut table = Table1::<3>::default();
        table.read_csv("torque.csv", text).unwrap();
        assert_eq!((table.x, table.y), ([0.0, 100.0, 300.0], [5.0, 9.0, 1.0]), "{text:?}");
    }
    let mut map = Table2::<2, 3>::default();
    map.read_csv("map.csv", ";-1;0;1\n10;1;2;3\n20;4;5;6\n").unwrap();
    assert_eq!((map.x, map.y), ([10.0, 20.0], [-1.0, 0.0, 1.0]));
    assert_eq!(map.z, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
}

#[test]
fn mistakes_are_named_with_their_place() {
    for (text, expected) in [
        ("", "torque.csv: no rows; expected 3, the size of the table"),
        (
            "x,y\n0,5\n1,9\n",
            "torque.csv, line 3: the last of 2 rows; expected 3 rows, the size of the table",
        ),
        (
            "0,5\n1,9\n2,1\n\n3,1",
            "torque.csv, line 5: one more row; expected 3 rows, the size of the table",
        ),
        ("0,5\n1,9,2\n2,1", "torque.csv, line 2: 3 columns; expected 2"),
        (
            "0;5\n1;9,5\n2;1",
            "torque.csv, line 2, column 2: \"9,5\"; expected a number such as 1.5 or -2e-3",
        ),
        (
            "0,5\n1,\n2,1",
            "torque.csv, line 2, column 2: \"\"; expected a number such as 1.5 or -2e-3",
        ),
        (
            "0,5\n1,inf\n2,1",
            "torque.csv, line 2, column 2: \"inf\"; expected a number such as 1.5 or -2e-3",
        ),
        (
            "0,5\n1,9\n1,1",
            "torque.csv, line 3, column 1: 1; expected more than 1, because an axis increases strictly",
        ),
    ] {
        assert_eq!(error_of_3_points(text), expected);
    }
}

#[test]
fn mistakes_in_a_map_are_named_with_their_place() {
    for (text, expected) in [
        ("", "map.csv: empty; expected the axis of the columns in its first line"),
        ("m,0,1\n", "map.csv, line 1: 3 columns; expected 4"),
        (
            "m,0,2,1\n0,1,2,3\n1,1,2,3",
            "map.csv, line 1, column 4: 1; expected more than 2, because an axis increases strictly",
        ),
        (
            "m,0,1,x\n0,1,2,3\n1,1,2,3",
            "map.csv, line 1, column 4: \"x\"; expected a number such as 1.5 or -2e-3",
        ),
        (
            "m,0,1,2\n0,1,2,3\n",
            "map.csv, line 2: the last of 1 rows; expected 2 rows, the size of the table",
        ),
        ("m,0,1,2\n0,1,2,3\n1,1,2\n", "map.csv, line 3: 3 columns; expected 4"),
        (
            "m,0,1,2\n1,1,2,3\n0,1,2,3",
            "map.csv, line 3, column 1: 0; expected more than 1, because an axis increases strictly",
        ),
    ] {
        assert_eq!(error_of_2_rows(text), expected);
    }
}
