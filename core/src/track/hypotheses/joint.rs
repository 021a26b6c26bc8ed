//! A Gaussian over a pose and planes: mean apart, covariance packed, measurements taken one number
//! at a time.

/// A symmetric covariance of at most `ROWS` rows: the lower triangle, row by row, so that a new
/// variable is appended without moving anything. `PACKED` is ROWS·(ROWS + 1)/2.
///
/// Invariant: `rows` ≤ `ROWS`.
#[derive(Clone, Debug)]
pub(super) struct Joint<const ROWS: usize, const PACKED: usize> {
    lower: [f32; PACKED],
    rows: usize,
}

const fn start(row: usize) -> usize {
    row * (row + 1) / 2
}

/// A row of a measurement matrix that is zero but for two runs of variables, such as the pose and a
/// plane: where each begins, and the derivatives.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sparse<'a>(pub [(usize, &'a [f32]); 2]);

impl Sparse<'_> {
    fn entries(&self) -> impl Iterator<Item = (usize, f32)> {
        let runs = self.0.iter();
        let all = runs.flat_map(|(at, run)| run.iter().enumerate().map(move |(k, v)| (at + k, *v)));
        all.filter(|(_, v)| *v != 0.0)
    }

    /// Scalar product with a column.
    pub fn dot(&self, column: &[f32]) -> f32 {
        let mut sum = 0.0;
        for (row, v) in self.entries() {
            sum += v * column[row];
        }
        sum
    }
}

impl<const ROWS: usize, const PACKED: usize> Joint<ROWS, PACKED> {
    const SIZES_AGREE: () = assert!(PACKED == start(ROWS), "PACKED must be ROWS·(ROWS + 1)/2");

    /// No variables; all zero bits.
    pub const fn new() -> Self {
        let () = Self::SIZES_AGREE;
        Joint { lower: [0.0; PACKED], rows: 0 }
    }

    pub fn rows(&self) -> usize {
        self.rows
    }

    /// `rows` variables (at most `ROWS`) known without doubt.
    pub fn reset(&mut self, rows: usize) {
        self.rows = rows.min(ROWS);
        self.lower[..start(self.rows)].fill(0.0);
    }

    pub fn copy_from(&mut self, other: &Self) {
        self.rows = other.rows;
        let used = start(self.rows);
        self.lower[..used].copy_from_slice(&other.lower[..used]);
    }

    fn index(row: usize, column: usize) -> usize {
        if row >= column { start(row) + column } else { start(column) + row }
    }

    pub fn at(&self, row: usize, column: usize) -> f32 {
        self.lower[Self::index(row, column)]
    }

    pub fn set(&mut self, row: usize, column: usize, value: f32) {
        self.lower[Self::index(row, column)] = value;
    }

    pub fn add_variance(&mut self, row: usize, variance: f32) {
        self.lower[Self::index(row, row)] += variance;
    }

    /// Puts zero where rounding has taken more than there was.
    pub fn keep_variances(&mut self) {
        for row in 0..self.rows {
            let own = &mut self.lower[Self::index(row, row)];
            *own = crate::math::max(*own, 0.0);
        }
    }

    /// `out` = P·hᵀ.
    pub fn times(&self, h: Sparse<'_>, out: &mut [f32; ROWS]) {
        let out = &mut out[..self.rows];
        out.fill(0.0);
        for (c, v) in h.entries() {
            let (before, after) = out.split_at_mut(c + 1);
            for (o, p) in before.iter_mut().zip(&self.lower[start(c)..start(c + 1)]) {
                *o += v * p;
            }
            let mut index = start(c + 1) + c;
            for (i, o) in after.iter_mut().enumerate() {
                *o += v * self.lower[index];
                index += c + i + 2;
            }
        }
    }

    /// h·P·hᵀ.
    pub fn variance(&self, h: Sparse<'_>) -> f32 {
        let mut sum = 0.0;
        for (i, a) in h.entries() {
            for (j, b) in h.entries() {
                sum += a * b * self.at(i, j);
            }
        }
        sum
    }

    /// Conditions on the measurement y = h·x + noise and returns its log density; the state is
    /// untouched and the density zero where numbers are not finite. `gain` is scratch.
    pub fn observe(
        &mut self,
        mean: &mut [f32; ROWS],
        gain: &mut [f32; ROWS],
        h: Sparse<'_>,
        (y, noise): (f32, f32),
    ) -> f32 {
        self.times(h, gain);
        let total = h.dot(gain) + noise;
        let error = y - h.dot(mean);
        if !(total > 0.0 && total.is_finite() && error.is_finite()) {
            return f32::NEG_INFINITY;
        }
        let inverse = 1.0 / total;
        let scaled = error * inverse;
        for (m, g) in mean.iter_mut().zip(&gain[..self.rows]) {
            *m += g * scaled;
        }
        self.add_outer(gain, -inverse);
        log_normal(error, total)
    }

    /// Conditions the covariance on one variable being told without doubt; `gain` is scratch. Of a
    /// variable that those told before leave hardly any of its variance (`before`) nothing is new.
    pub fn tell(&mut self, row: usize, before: f32, gain: &mut [f32; ROWS]) {
        self.times(Sparse([(row, &[1.0]), (0, &[])]), gain);
        let left = gain[row];
        if left > 1e-5 * before {
            self.add_outer(gain, -1.0 / left);
        }
    }

    /// Moves the belief by the first two derivatives `slope` and `bend` (not above zero) of a log
    /// likelihood in h·x; `gain` is P·hᵀ.
    pub fn nudge(&mut self, mean: &mut [f32; ROWS], gain: &[f32; ROWS], slope: f32, bend: f32) {
        for (m, g) in mean.iter_mut().zip(&gain[..self.rows]) {
            *m += g * slope;
        }
        self.add_outer(gain, bend);
    }

    /// P += scale · g·gᵀ.
    #[inline(never)]
    fn add_outer(&mut self, g: &[f32; ROWS], scale: f32) {
        let mut rest = &mut self.lower[..start(self.rows)];
        for i in 0..self.rows {
            let (row, later) = rest.split_at_mut(i + 1);
            let by = g[i] * scale;
            for (p, g) in row.iter_mut().zip(&g[..=i]) {
                *p += by * g;
            }
            rest = later;
        }
    }

    /// Appends a variable whose covariance with the rows so far is in `covariance`, and its own.
    /// Ignored when full.
    pub fn append(&mut self, covariance: &[f32], own: f32) {
        let n = self.rows;
        if n < ROWS && covariance.len() >= n {
            self.lower[start(n)..start(n) + n].copy_from_slice(&covariance[..n]);
            self.lower[start(n) + n] = own;
            self.rows = n + 1;
        }
    }

    /// Forgets the rows `first..first + count`.
    pub fn remove(&mut self, first: usize, count: usize) {
        let mut to = start(first);
        for i in first + count..self.rows {
            for j in (0..=i).filter(|j| !(first..first + count).contains(j)) {
                self.lower[to] = self.lower[start(i) + j];
                to += 1;
            }
        }
        self.rows = self.rows.saturating_sub(count);
    }

    /// Replaces the variables `first..first + size` (at most six) by T times them.
    pub fn transform(&mut self, first: usize, size: usize, t: impl Fn(usize, usize) -> f32) {
        let inside = first..first + size;
        let mut mixed = [0.0; 6];
        for other in (0..self.rows).filter(|r| !inside.contains(r)) {
            for i in 0..size {
                mixed[i] = 0.0;
                for j in 0..size {
                    mixed[i] += t(i, j) * self.at(first + j, other);
                }
            }
            for (i, value) in mixed.iter().enumerate().take(size) {
                self.set(first + i, other, *value);
            }
        }
        let mut block = [[0.0; 6]; 6];
        for i in 0..size {
            for j in 0..size {
                for k in 0..size {
                    block[i][j] += t(i, k) * self.at(first + k, first + j);
                }
            }
        }
        for i in 0..size {
            for j in 0..=i {
                let mut sum = 0.0;
                for k in 0..size {
                    sum += block[i][k] * t(j, k);
                }
                self.set(first + i, first + j, sum);
            }
        }
    }
}

/// Log density of a normal deviate.
pub(super) fn log_normal(error: f32, variance: f32) -> f32 {
    const LOG_TAU: f32 = 1.837_877_1;
    -0.5 * (error * error / variance + crate::math::ln(variance) + LOG_TAU)
}
