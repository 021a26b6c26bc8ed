//! Means with their intervals.

/// The mean of independent runs, and half of its 95 % interval: Student's, for the spread is known from the
/// runs alone. NaN where there are too few: the mean of none, the interval of one.
pub(crate) fn mean(sample: impl IntoIterator<Item = f64>) -> (f64, f64) {
    let sample: Vec<f64> = sample.into_iter().collect();
    let n = sample.len() as f64;
    let mean = sample.iter().sum::<f64>() / n;
    let squared = sample.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
    (mean, student(sample.len()) * (squared / (n * (n - 1.0))).sqrt())
}

/// The quantile 0.975 of Student's t of the mean of so many: exact for two and three, else by the expansion
/// about the normal distribution (Abramowitz and Stegun 26.7.5), within 1 %.
fn student(count: usize) -> f64 {
    const Z: f64 = 1.959_964;
    let n = match count {
        0 | 1 => return f64::NAN,
        2 => return 12.706,
        3 => return 4.303,
        more => (more - 1) as f64,
    };
    let first = (Z.powi(3) + Z) / 4.0;
    let second = (5.0 * Z.powi(5) + 16.0 * Z.powi(3) + 3.0 * Z) / 96.0;
    let third = (3.0 * Z.powi(7) + 19.0 * Z.powi(5) + 17.0 * Z.powi(3) - 15.0 * Z) / 384.0;
    Z + first / n + second / (n * n) + third / (n * n * n)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_wider_the_fewer_runs_there_are() {
        // From tables.
        for (count, t) in [(2, 12.706), (4, 3.182), (10, 2.262), (40, 2.023), (1000, 1.962)] {
            assert!((student(count) / t - 1.0).abs() < 0.01, "{count}: {}", student(count));
        }
        let (value, half) = mean([1.0, 2.0, 3.0, 4.0]);
        assert!((value - 2.5).abs() < 1e-12 && (half - 2.054).abs() < 0.02, "{value} ± {half}");
        assert!(mean([3.0]).1.is_nan() && mean([3.0]).0 == 3.0 && mean([]).0.is_nan());
    }
}
