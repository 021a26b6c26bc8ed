//! Sums of products as if in twice the precision, where large terms cancel.

/// A sum of products whose rounding errors are added up beside it (Ogita, Rump and Oishi, SIAM Journal
/// on Scientific Computing 26, 2005, algorithm 5.3): as accurate as in twice the precision, rounded
/// once at the end, while no term exceeds 10³⁴. Without fused multiply-add, so that results agree to
/// the last bit on every target.
///
/// ```
/// use tactile_core::accurate::Sum;
///
/// let mut sum = Sum::from(1e8);
/// sum.add_product(3.0, 0.1);
/// sum.add_product(-1e4, 1e4);
/// assert_eq!(sum.value(), 0.3);
/// assert_eq!(1e8 + 3.0 * 0.1 - 1e4 * 1e4, 0.0_f32);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sum {
    sum: f32,
    errors: f32,
}

impl From<f32> for Sum {
    fn from(first: f32) -> Self {
        Sum { sum: first, errors: 0.0 }
    }
}

impl Sum {
    /// Adds a·b.
    #[inline(never)]
    pub fn add_product(&mut self, a: f32, b: f32) {
        let (product, lost) = product(a, b);
        let sum = self.sum + product;
        // What the sum rounded off (Knuth).
        let added = sum - self.sum;
        self.errors += (self.sum - (sum - added)) + (product - added) + lost;
        self.sum = sum;
    }

    /// The sum, rounded.
    #[inline]
    pub fn value(&self) -> f32 {
        self.sum + self.errors
    }
}

/// a·b and what it rounded off (Dekker).
#[inline]
fn product(a: f32, b: f32) -> (f32, f32) {
    let product = a * b;
    let ((a0, a1), (b0, b1)) = (halves(a), halves(b));
    (product, a1 * b1 - (((product - a0 * b0) - a1 * b0) - a0 * b1))
}

/// Two halves of the digits, whose products are exact (Veltkamp).
#[inline]
fn halves(x: f32) -> (f32, f32) {
    /// 2¹² + 1.
    const SPLIT: f32 = 4097.0;
    let wide = SPLIT * x;
    let high = wide - (wide - x);
    (high, x - high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn as_in_twice_the_precision(terms in prop::collection::vec((-1e3f32..1e3, -1e3f32..1e3), 0..200)) {
            let mut sum = Sum::from(0.0);
            for (a, b) in &terms {
                sum.add_product(*a, *b);
            }
            let exact: f64 = terms.iter().map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
            let size: f64 = terms.iter().map(|(a, b)| (f64::from(*a) * f64::from(*b)).abs()).sum();
            let off = (f64::from(sum.value()) - exact).abs();
            prop_assert!(off <= 6e-8 * exact.abs() + 1e-12 * size, "{off} of {exact}, {size}");
        }

        #[test]
        fn what_a_product_loses_is_exact(a in -1e6f32..1e6, b in -1e6f32..1e6) {
            let (product, lost) = product(a, b);
            prop_assert_eq!(f64::from(product) + f64::from(lost), f64::from(a) * f64::from(b));
        }
    }
}
