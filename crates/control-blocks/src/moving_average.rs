//! The moving average.

/// Mean of the last `N` samples, at the beginning of those that there are.
///
/// `y(k) = (u(k) + u(k-1) + ... + u(k-N+1)) / N`: A. V. Oppenheim and R. W. Schafer, *Discrete-Time Signal Processing*
/// (3rd ed., Pearson, 2010), chapter 2. Each output is summed anew, so rounding errors do not add up.
///
/// ```
/// use control_blocks::MovingAverage;
///
/// let mut average = MovingAverage::<3>::default();
/// assert_eq!([1.0, 3.0, 5.0, 7.0].map(|u| average.update(u)), [1.0, 2.0, 3.0, 5.0]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct MovingAverage<const N: usize> {
    /// State: the last samples; sample k is in place k modulo `N`.
    #[cfg_attr(feature = "serde", serde(with = "crate::arrays"))]
    pub samples: [f64; N],
    /// State: the number of samples so far.
    pub count: u64,
}

impl<const N: usize> Default for MovingAverage<N> {
    fn default() -> Self {
        Self { samples: [0.0; N], count: 0 }
    }
}

impl<const N: usize> MovingAverage<N> {
    /// The mean with the sample `u`.
    pub fn update(&mut self, u: f64) -> f64 {
        const { assert!(N > 0, "a moving average has at least one sample") };
        self.samples[(self.count % N as u64) as usize] = u;
        self.count += 1;
        let filled = &self.samples[..self.count.min(N as u64) as usize];
        filled.iter().sum::<f64>() / filled.len() as f64
    }

    /// Forgets all samples.
    pub fn reset(&mut self) {
        *self = Self::default();
    }
}
