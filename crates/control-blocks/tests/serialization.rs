//! Blocks are serialized with their states.
#![cfg(feature = "serde")]

use control_blocks::{Kalman, MovingAverage, Pid};

#[test]
fn blocks_go_on_as_before_after_they_were_restored() {
    let mut average = MovingAverage::<40>::default();
    let mut filter = Kalman::<2, 1, 1> { c: [[1.0, 1.0]], ..Kalman::default() };
    let mut pid = Pid { ki: 2.0, kd: 1.0, tf: 0.5, ..Pid::default() };
    let mut update = |u: f64| {
        let estimate = filter.update([0.0], [u]).unwrap();
        let found = (average.update(u), estimate, pid.update(1.0, u, 0.1));
        let bytes = postcard::to_allocvec(&(&average, &filter, &pid)).unwrap();
        (average, filter, pid) = postcard::from_bytes(&bytes).unwrap();
        found
    };
    let with_restoring: Vec<_> = (0..50).map(|k| update(f64::from(k).sqrt())).collect();
    let mut average = MovingAverage::<40>::default();
    let mut filter = Kalman::<2, 1, 1> { c: [[1.0, 1.0]], ..Kalman::default() };
    let mut pid = Pid { ki: 2.0, kd: 1.0, tf: 0.5, ..Pid::default() };
    for (k, found) in (0..50).zip(with_restoring) {
        let u = f64::from(k).sqrt();
        let estimate = filter.update([0.0], [u]).unwrap();
        assert_eq!(found, (average.update(u), estimate, pid.update(1.0, u, 0.1)));
    }
}

#[test]
fn an_array_of_another_length_is_refused() {
    let bytes = postcard::to_allocvec(&MovingAverage::<40>::default()).unwrap();
    assert!(postcard::from_bytes::<MovingAverage<41>>(&bytes).is_err());
}
