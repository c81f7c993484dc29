//! Systems of linear equations, solved by Gaussian elimination with partial pivoting.

/// Replaces a square matrix, row by row, by its factors, and notes the exchanges of rows in `pivots`. Returns false if the
/// matrix is singular or not finite. The zeros of sparse matrices cost little time.
pub fn factorize(matrix: &mut [f64], pivots: &mut [usize]) -> bool {
    let n = pivots.len();
    for k in 0..n {
        let largest = (k..n).fold(k, |largest, row| {
            let is_larger = matrix[row * n + k].abs() > matrix[largest * n + k].abs();
            if is_larger { row } else { largest }
        });
        pivots[k] = largest;
        if largest != k {
            let (above, below) = matrix.split_at_mut(largest * n);
            above[k * n..][..n].swap_with_slice(&mut below[..n]);
        }
        let (above, below) = matrix.split_at_mut((k + 1) * n);
        let pivot_row = &above[k * n..];
        let pivot = pivot_row[k];
        if pivot == 0.0 || !pivot.is_finite() {
            return false;
        }
        for row in below.chunks_exact_mut(n) {
            if row[k] != 0.0 {
                let factor = row[k] / pivot;
                row[k] = factor;
                let pairs = row[k + 1..].iter_mut().zip(&pivot_row[k + 1..]);
                pairs.for_each(|(value, of_pivot)| *value -= factor * of_pivot);
            }
        }
    }
    true
}

/// Replaces the right side of the equations by their solution, from what [`factorize`] has left.
pub fn solve(factors: &[f64], pivots: &[usize], right: &mut [f64]) {
    let n = pivots.len();
    for (k, &pivot) in pivots.iter().enumerate() {
        right.swap(k, pivot);
    }
    for row in 0..n {
        let (known, rest) = right.split_at_mut(row);
        rest[0] -= product(&factors[row * n..][..row], known);
    }
    for row in (0..n).rev() {
        let (rest, known) = right.split_at_mut(row + 1);
        let of_row = &factors[row * n..][..n];
        rest[row] = (rest[row] - product(&of_row[row + 1..], known)) / of_row[row];
    }
}

fn product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    #[test]
    fn equations_with_a_zero_on_the_diagonal_are_solved() {
        let mut matrix = vec![0.0, 2.0, 1.0, 1.0, 1.0, 0.0, 4.0, 0.0, 3.0];
        let (mut pivots, mut right) = ([0; 3], [7.0, 3.0, 13.0]);
        assert!(factorize(&mut matrix, &mut pivots));
        solve(&matrix, &pivots, &mut right);
        assert_eq!(right, [1.0, 2.0, 3.0]);
    }

    #[test]
    fn a_singular_matrix_is_refused() {
        assert!(!factorize(&mut [1.0, 2.0, 2.0, 4.0], &mut [0; 2]));
        assert!(!factorize(&mut [f64::NAN], &mut [0]));
    }
}
