//! Products of four rows of a factor with what is solved for, where most of a factor's time goes.
//!
//! On a Cortex-M4F the compiler has an addition follow the multiplication that it waits for, and loads numbers
//! one by one; there the loops are written out: several numbers a load, and no result is taken by the next
//! instruction. Multiplications and additions are those of the plain loops, in the same order, so that bits
//! are the same.

/// Rows worked on together, so that each number of the right-hand side is loaded once for all of them.
pub(super) const TOGETHER: usize = 4;

/// Whether a host takes two blocks of rows at once: it has registers for eight rows, and time for them while a
/// sum waits for the one before.
pub(super) const IN_PAIRS: bool = !cfg!(target_arch = "arm");

/// Σ lₖ xₖ over the columns of `x` for each row of two blocks, the bits of [`products`].
#[inline(always)]
pub(super) fn pair_of_products<const C: usize>(
    [a, b]: [[&[f32]; TOGETHER]; 2],
    x: &[[f32; C]],
) -> [[[f32; C]; TOGETHER]; 2] {
    let (a, b) = (a.map(|row| &row[..x.len()]), b.map(|row| &row[..x.len()]));
    let mut sums = [[[0.0f32; C]; TOGETHER]; 2];
    for (k, x) in x.iter().enumerate() {
        for r in 0..TOGETHER {
            for c in 0..C {
                sums[0][r][c] += a[r][k] * x[c];
                sums[1][r][c] += b[r][k] * x[c];
            }
        }
    }
    sums
}

/// Goes on with the sums of [`products`] over columns that follow.
#[inline(always)]
pub(super) fn add_products<const C: usize>(
    rows: [&[f32]; TOGETHER],
    x: &[[f32; C]],
    sums: &mut [[f32; C]; TOGETHER],
) {
    for (row, sums) in rows.iter().zip(sums) {
        for (l, x) in row.iter().zip(x) {
            for c in 0..C {
                sums[c] += l * x[c];
            }
        }
    }
}

/// Σ lₖ xₖ for each row and each side; rows and `x` are equally long, a multiple of four.
#[inline(always)]
pub(super) fn products<const C: usize>(
    rows: [&[f32]; TOGETHER],
    x: &[[f32; C]],
) -> [[f32; C]; TOGETHER] {
    #[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
    if C == 3 || C == 4 {
        return cortex_m::products(rows, x);
    }
    let mut sums = [[0.0f32; C]; TOGETHER];
    let [l0, l1, l2, l3] = rows;
    for ((((l0, l1), l2), l3), x) in l0.iter().zip(l1).zip(l2).zip(l3).zip(x) {
        for c in 0..C {
            sums[0][c] += l0 * x[c];
            sums[1][c] += l1 * x[c];
            sums[2][c] += l2 * x[c];
            sums[3][c] += l3 * x[c];
        }
    }
    sums
}

/// Σ lₖ xₖ of one row for each side, the bits of [`products`].
#[inline(always)]
pub(super) fn one_product<const C: usize>(row: &[f32], x: &[[f32; C]]) -> [f32; C] {
    let mut sums = [0.0f32; C];
    for (l, x) in row.iter().zip(x) {
        for c in 0..C {
            sums[c] += l * x[c];
        }
    }
    sums
}

/// Σ lₖ xₖ for each row, in four partial sums of every fourth product: sixteen in flight, or four vectors.
/// Rows and `x` are equally long, a multiple of four.
#[inline(always)]
pub(super) fn four_products(rows: [&[f32]; TOGETHER], x: &[f32]) -> [f32; TOGETHER] {
    #[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
    return cortex_m::four_products(rows, x);
    #[cfg(not(all(target_arch = "arm", target_abi = "eabihf")))]
    {
        let mut sums = [[0.0f32; 4]; TOGETHER];
        let [a, b, c, d] = rows.map(|row| row.as_chunks::<4>().0);
        for ((((a, b), c), d), x) in a.iter().zip(b).zip(c).zip(d).zip(x.as_chunks::<4>().0) {
            for j in 0..4 {
                sums[0][j] += a[j] * x[j];
                sums[1][j] += b[j] * x[j];
                sums[2][j] += c[j] * x[j];
                sums[3][j] += d[j] * x[j];
            }
        }
        sums.map(|[a, b, c, d]| (a + b) + (c + d))
    }
}

#[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
#[allow(unsafe_code)]
mod cortex_m {
    use core::arch::asm;
    use core::mem::MaybeUninit;

    use super::TOGETHER;

    /// Blocks of `size` columns that all slices hold.
    fn blocks(rows: &[&[f32]; TOGETHER], columns: usize, size: usize) -> usize {
        rows.iter().fold(columns, |least, row| least.min(row.len())) / size
    }

    /// For three or four sides.
    #[inline(always)]
    pub fn products<const C: usize>(
        rows: [&[f32]; TOGETHER],
        x: &[[f32; C]],
    ) -> [[f32; C]; TOGETHER] {
        // Columns of three are taken four at a time, those of four in pairs.
        let blocks = blocks(&rows, x.len(), if C == 3 { 4 } else { 2 });
        if blocks == 0 {
            return [[0.0; C]; TOGETHER];
        }
        let rows = rows.map(<[f32]>::as_ptr);
        let mut sums = MaybeUninit::<[[f32; C]; TOGETHER]>::uninit();
        let (x, out) = (x.as_ptr().cast(), sums.as_mut_ptr().cast());
        // SAFETY: so many blocks are in all slices, whose numbers have C sides, and all sums are written.
        unsafe {
            if C == 3 {
                three_sides(rows, x, blocks, out)
            } else {
                four_sides(rows, x, blocks, out)
            }
            sums.assume_init()
        }
    }

    /// One row's four columns times three sides (s12 to s23), added to `a`, `b`, `c`.
    macro_rules! row_of_three {
        ($row:literal, $a:literal, $b:literal, $c:literal) => {
            concat!(
                "vldmia {", $row, "}!, {{s24-s27}}\n",
                row_of_three!(@ "s24", "s12", "s13", "s14", $a, $b, $c),
                row_of_three!(@ "s25", "s15", "s16", "s17", $a, $b, $c),
                row_of_three!(@ "s26", "s18", "s19", "s20", $a, $b, $c),
                row_of_three!(@ "s27", "s21", "s22", "s23", $a, $b, $c),
            )
        };
        (@ $l:literal, $x:literal, $y:literal, $z:literal, $a:literal, $b:literal, $c:literal) => {
            concat!(
                "vmul.f32 s28, ", $l, ", ", $x, "\n",
                "vmul.f32 s29, ", $l, ", ", $y, "\n",
                "vmul.f32 s30, ", $l, ", ", $z, "\n",
                "vadd.f32 ", $a, ", ", $a, ", s28\n",
                "vadd.f32 ", $b, ", ", $b, ", s29\n",
                "vadd.f32 ", $c, ", ", $c, ", s30\n",
            )
        };
    }

    /// Writes twelve sums to `out`.
    ///
    /// # Safety
    /// There are 4·`blocks` numbers in each row and 12·`blocks` at `x`, and `blocks` is not zero.
    #[inline(always)]
    unsafe fn three_sides(
        rows: [*const f32; TOGETHER],
        x: *const f32,
        blocks: usize,
        out: *mut f32,
    ) {
        // SAFETY: the caller's; registers that change are named.
        unsafe {
            asm!(
                "vmov s0, {zero}",
                "vmov s1, {zero}",
                "vmov s2, {zero}",
                "vmov s3, {zero}",
                "vmov s4, {zero}",
                "vmov s5, {zero}",
                "vmov s6, {zero}",
                "vmov s7, {zero}",
                "vmov s8, {zero}",
                "vmov s9, {zero}",
                "vmov s10, {zero}",
                "vmov s11, {zero}",
                "2:",
                "vldmia {x}!, {{s12-s23}}",
                row_of_three!("a", "s0", "s1", "s2"),
                row_of_three!("b", "s3", "s4", "s5"),
                row_of_three!("c", "s6", "s7", "s8"),
                row_of_three!("d", "s9", "s10", "s11"),
                "subs {blocks}, {blocks}, #1",
                "bne 2b",
                "vstmia {out}, {{s0-s11}}",
                a = inout(reg) rows[0] => _,
                b = inout(reg) rows[1] => _,
                c = inout(reg) rows[2] => _,
                d = inout(reg) rows[3] => _,
                x = inout(reg) x => _,
                blocks = inout(reg) blocks => _,
                out = in(reg) out,
                zero = in(reg) 0,
                out("s0") _, out("s1") _, out("s2") _, out("s3") _, out("s4") _, out("s5") _,
                out("s6") _, out("s7") _, out("s8") _, out("s9") _, out("s10") _, out("s11") _,
                out("s12") _, out("s13") _, out("s14") _, out("s15") _, out("s16") _, out("s17") _,
                out("s18") _, out("s19") _, out("s20") _, out("s21") _, out("s22") _, out("s23") _,
                out("s24") _, out("s25") _, out("s26") _, out("s27") _, out("s28") _, out("s29") _,
                out("s30") _,
                options(nostack),
            );
        }
    }

    /// One row's two columns times four sides (s16 to s23), added to `a` to `d`.
    macro_rules! row_of_four {
        ($row:literal, $a:literal, $b:literal, $c:literal, $d:literal) => {
            concat!(
                "vldmia {", $row, "}!, {{s24-s25}}\n",
                row_of_four!(@ "s24", "s16", "s17", "s18", "s19", $a, $b, $c, $d),
                row_of_four!(@ "s25", "s20", "s21", "s22", "s23", $a, $b, $c, $d),
            )
        };
        (@ $l:literal, $w:literal, $x:literal, $y:literal, $z:literal,
            $a:literal, $b:literal, $c:literal, $d:literal) => {
            concat!(
                "vmul.f32 s26, ", $l, ", ", $w, "\n",
                "vmul.f32 s27, ", $l, ", ", $x, "\n",
                "vmul.f32 s28, ", $l, ", ", $y, "\n",
                "vmul.f32 s29, ", $l, ", ", $z, "\n",
                "vadd.f32 ", $a, ", ", $a, ", s26\n",
                "vadd.f32 ", $b, ", ", $b, ", s27\n",
                "vadd.f32 ", $c, ", ", $c, ", s28\n",
                "vadd.f32 ", $d, ", ", $d, ", s29\n",
            )
        };
    }

    /// Writes sixteen sums to `out`.
    ///
    /// # Safety
    /// There are 2·`blocks` numbers in each row and 8·`blocks` at `x`, and `blocks` is not zero.
    #[inline(always)]
    unsafe fn four_sides(
        rows: [*const f32; TOGETHER],
        x: *const f32,
        blocks: usize,
        out: *mut f32,
    ) {
        // SAFETY: the caller's; registers that change are named.
        unsafe {
            asm!(
                "vmov s0, {zero}",
                "vmov s1, {zero}",
                "vmov s2, {zero}",
                "vmov s3, {zero}",
                "vmov s4, {zero}",
                "vmov s5, {zero}",
                "vmov s6, {zero}",
                "vmov s7, {zero}",
                "vmov s8, {zero}",
                "vmov s9, {zero}",
                "vmov s10, {zero}",
                "vmov s11, {zero}",
                "vmov s12, {zero}",
                "vmov s13, {zero}",
                "vmov s14, {zero}",
                "vmov s15, {zero}",
                "2:",
                "vldmia {x}!, {{s16-s23}}",
                row_of_four!("a", "s0", "s1", "s2", "s3"),
                row_of_four!("b", "s4", "s5", "s6", "s7"),
                row_of_four!("c", "s8", "s9", "s10", "s11"),
                row_of_four!("d", "s12", "s13", "s14", "s15"),
                "subs {blocks}, {blocks}, #1",
                "bne 2b",
                "vstmia {out}, {{s0-s15}}",
                a = inout(reg) rows[0] => _,
                b = inout(reg) rows[1] => _,
                c = inout(reg) rows[2] => _,
                d = inout(reg) rows[3] => _,
                x = inout(reg) x => _,
                blocks = inout(reg) blocks => _,
                out = in(reg) out,
                zero = in(reg) 0,
                out("s0") _, out("s1") _, out("s2") _, out("s3") _, out("s4") _, out("s5") _,
                out("s6") _, out("s7") _, out("s8") _, out("s9") _, out("s10") _, out("s11") _,
                out("s12") _, out("s13") _, out("s14") _, out("s15") _, out("s16") _, out("s17") _,
                out("s18") _, out("s19") _, out("s20") _, out("s21") _, out("s22") _, out("s23") _,
                out("s24") _, out("s25") _, out("s26") _, out("s27") _, out("s28") _, out("s29") _,
                options(nostack),
            );
        }
    }

    /// One row's four columns times those of the right-hand side (s16 to s19), added to `a` to `d`.
    macro_rules! row {
        ($row:literal, $a:literal, $b:literal, $c:literal, $d:literal) => {
            concat!(
                "vldmia {",
                $row,
                "}!, {{s20-s23}}\n",
                "vmul.f32 s24, s16, s20\n",
                "vmul.f32 s25, s17, s21\n",
                "vmul.f32 s26, s18, s22\n",
                "vmul.f32 s27, s19, s23\n",
                "vadd.f32 ",
                $a,
                ", ",
                $a,
                ", s24\n",
                "vadd.f32 ",
                $b,
                ", ",
                $b,
                ", s25\n",
                "vadd.f32 ",
                $c,
                ", ",
                $c,
                ", s26\n",
                "vadd.f32 ",
                $d,
                ", ",
                $d,
                ", s27\n",
            )
        };
    }

    #[inline(always)]
    pub fn four_products(rows: [&[f32]; TOGETHER], x: &[f32]) -> [f32; TOGETHER] {
        let blocks = blocks(&rows, x.len(), 4);
        if blocks == 0 {
            return [0.0; TOGETHER];
        }
        let mut sums = MaybeUninit::<[f32; TOGETHER]>::uninit();
        // SAFETY: `blocks` times four numbers are read of each row and of `x`, and all four sums are written;
        // registers that change are named.
        unsafe {
            asm!(
                "vmov s0, {zero}",
                "vmov s1, {zero}",
                "vmov s2, {zero}",
                "vmov s3, {zero}",
                "vmov s4, {zero}",
                "vmov s5, {zero}",
                "vmov s6, {zero}",
                "vmov s7, {zero}",
                "vmov s8, {zero}",
                "vmov s9, {zero}",
                "vmov s10, {zero}",
                "vmov s11, {zero}",
                "vmov s12, {zero}",
                "vmov s13, {zero}",
                "vmov s14, {zero}",
                "vmov s15, {zero}",
                // Pairs of blocks; where their number is odd, the first is half a pair.
                "lsrs {blocks}, {blocks}, #1",
                "adc {blocks}, {blocks}, #0",
                "bcs 3f",
                "2:",
                "vldmia {x}!, {{s16-s19}}",
                row!("a", "s0", "s1", "s2", "s3"),
                row!("b", "s4", "s5", "s6", "s7"),
                row!("c", "s8", "s9", "s10", "s11"),
                row!("d", "s12", "s13", "s14", "s15"),
                "3:",
                "vldmia {x}!, {{s16-s19}}",
                row!("a", "s0", "s1", "s2", "s3"),
                row!("b", "s4", "s5", "s6", "s7"),
                row!("c", "s8", "s9", "s10", "s11"),
                row!("d", "s12", "s13", "s14", "s15"),
                "subs {blocks}, {blocks}, #1",
                "bne 2b",
                "vadd.f32 s0, s0, s1",
                "vadd.f32 s2, s2, s3",
                "vadd.f32 s4, s4, s5",
                "vadd.f32 s6, s6, s7",
                "vadd.f32 s8, s8, s9",
                "vadd.f32 s10, s10, s11",
                "vadd.f32 s12, s12, s13",
                "vadd.f32 s14, s14, s15",
                "vadd.f32 s0, s0, s2",
                "vadd.f32 s1, s4, s6",
                "vadd.f32 s2, s8, s10",
                "vadd.f32 s3, s12, s14",
                "vstmia {sums}, {{s0-s3}}",
                a = inout(reg) rows[0].as_ptr() => _,
                b = inout(reg) rows[1].as_ptr() => _,
                c = inout(reg) rows[2].as_ptr() => _,
                d = inout(reg) rows[3].as_ptr() => _,
                x = inout(reg) x.as_ptr() => _,
                blocks = inout(reg) blocks => _,
                sums = in(reg) sums.as_mut_ptr(),
                zero = in(reg) 0,
                out("s0") _, out("s1") _, out("s2") _, out("s3") _, out("s4") _, out("s5") _,
                out("s6") _, out("s7") _, out("s8") _, out("s9") _, out("s10") _, out("s11") _,
                out("s12") _, out("s13") _, out("s14") _, out("s15") _, out("s16") _, out("s17") _,
                out("s18") _, out("s19") _, out("s20") _, out("s21") _, out("s22") _, out("s23") _,
                out("s24") _, out("s25") _, out("s26") _, out("s27") _,
                options(nostack),
            );
            sums.assume_init()
        }
    }
}
