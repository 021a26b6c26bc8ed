//! What a map's mean and one more row cost beside the least that the arithmetic takes
//! (`cargo fw cycles bench-map`).
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(not(target_os = "none"))]
fn main() {}

#[cfg(all(target_os = "none", not(feature = "mps2-an386")))]
compile_error!("only the mps2-an386 board counts instructions");

#[cfg(all(target_os = "none", feature = "mps2-an386"))]
mod firmware {
    use core::hint::black_box;

    use cortex_m_semihosting::{debug, hprintln};
    use tactile_core::contact::Contact;
    use tactile_core::matrix::{Coordinates, Vector};
    use tactile_core::random::Random;
    use tactile_core::space::{Planar, Space, Spatial};
    use tactile_core::surface::cholesky::packed;
    use tactile_core::surface::{
        Ball, Gpis, Kernel, Map, Matern32, Prior, Surface, ThinPlate, Training,
    };
    use tactile_firmware::board::Selected;
    use tactile_firmware::counter::{Counter, print_beside};

    const ROWS: usize = 96;

    type Of<S, K, const SITES: usize> = Gpis<S, K, Ball<S>, SITES, ROWS, { packed(ROWS) }>;

    /// The least cycles of what the mathematics needs, by the timings of `cargo fw cycles`: every
    /// number of the map is loaded once, sums and constants stay in registers, nothing waits, and
    /// loops, addresses, the prior and comparisons cost nothing.
    mod floor {
        /// An addition, a multiplication, a load or a store.
        const ONE: usize = 1;
        /// A square root or a division.
        pub const ROOT: usize = 14;
        /// eˣ: reduction 7, a polynomial of degree six 14, the power of two 4.
        const EXP: usize = 25 * ONE;

        /// A kernel's k, a and b after the squared distance.
        #[derive(Clone, Copy)]
        pub struct Radial {
            pub k: usize,
            pub a: usize,
            pub b: usize,
        }

        /// r; 2r − 3R, times r², times the scale, plus s²; r − R, times the scale; 6 scale/r.
        pub const THIN_PLATE: Radial = Radial { k: ROOT + 5 * ONE, a: 2 * ONE, b: ROOT };
        /// r, −rate·r, its exponential, times s²; 1 + u, times that; times −rate²; times rate, by r.
        pub const MATERN: Radial = Radial { k: ROOT + EXP + 4 * ONE, a: ONE, b: ONE + ROOT };

        /// The difference of two points in d dimensions, one of them loaded, and its square.
        const fn apart(d: usize) -> usize {
            (d + d + 2 * d - 1) * ONE
        }

        /// One site's part of the mean: its weights loaded and a product added for each.
        pub const fn mean(d: usize, radial: Radial, slopes: bool) -> usize {
            let value = apart(d) + radial.k + 3 * ONE;
            // Weights, g·d, times a, subtracted.
            if slopes { value + radial.a + (3 * d - 1 + 2) * ONE } else { value }
        }

        /// One site's part of the gradient beside the mean.
        pub const fn gradient(d: usize, radial: Radial, slopes: bool) -> usize {
            let value = (1 + 2 * d) * ONE;
            // w·a − b·(g·d); minus g·a.
            if slopes { value + radial.b + (2 + 2 * d) * ONE } else { value + radial.a }
        }

        /// Rows of one more site after `sites` with as many rows each: covariances, one pass over
        /// the factor for all of them, their own products, diagonals.
        pub const fn append(d: usize, radial: Radial, sites: usize, slopes: bool) -> usize {
            let more = if slopes { 1 + d } else { 1 };
            let n = sites * more;
            let covariance = if slopes {
                // a·d and its negative, b·d·d for half the matrix, a on its diagonal; stored.
                let slopes = 2 * d + d * (d + 1) + d + more * more - 1;
                radial.k + radial.a + radial.b + (slopes + 1) * ONE
            } else {
                radial.k + ONE
            };
            // Each number of the factor is loaded once, multiplied and added for each new row.
            let products = n * (n - 1) / 2 * (1 + 2 * more) * ONE;
            // 1/Lᵢᵢ loaded; each new number loaded, subtracted from, scaled and stored.
            let ends = n * (1 + 4 * more) * ONE;
            let own = (more * (more + 1) / 2) * (2 * n) * ONE;
            sites * (apart(d) + covariance) + products + ends + own + more * (2 * ROOT + 4 * ONE)
        }
    }

    /// Contacts spread over a ball of 40 mm, felt with 1 mm and 5° of noise.
    fn touch<S: Space>(random: &mut Random, felt: bool) -> Contact<S> {
        let normal = random.normal::<S::Vector>().normalized().unwrap_or(S::Vector::ZERO);
        Contact {
            point: normal * 0.04,
            normal: felt.then_some(normal),
            point_deviation: 1e-3,
            normal_deviation: 0.087,
            finger: 0,
        }
    }

    /// A map that is full but for one contact, which is then appended, and asked.
    #[inline(never)]
    fn map<S: Space, K: Kernel, const SITES: usize>(
        counter: &Counter,
        name: &str,
        map: &mut Of<S, K, SITES>,
        (kernel, radial): (K, floor::Radial),
        (point, felt): (S::Vector, bool),
    ) {
        let mut random = Random::new(2);
        map.configure(kernel, Ball::UNSET, Training::Normals);
        for _ in 0..SITES - 1 {
            map.insert(&touch(&mut random, felt));
        }
        hprintln!("{}, {} contacts:", name, SITES);
        let last = touch(&mut random, felt);
        let floor = floor::append(S::DIMENSION, radial, SITES - 1, felt);
        print_beside("  append the last contact", floor, || {
            counter.count(|| {
                black_box(map.insert(black_box(&last)));
            })
        });
        map.refit();
        let point = black_box(point);
        let mean = SITES * floor::mean(S::DIMENSION, radial, felt);
        print_beside("  mean at a point", mean, || {
            counter.count(|| {
                black_box(map.values(&[point]));
            })
        });
        let gradient = mean + SITES * floor::gradient(S::DIMENSION, radial, felt);
        print_beside("  mean and gradient, and variances' bounds", gradient, || {
            counter.count(|| {
                black_box(map.probe(point));
            })
        });
    }

    #[cortex_m_rt::entry]
    fn main() -> ! {
        static mut PLATE: Of<Spatial, ThinPlate, 96> = Gpis::new();
        static mut PLANAR: Of<Planar, Matern32, 32> = Gpis::new();
        static mut SPATIAL: Of<Spatial, Matern32, 24> = Gpis::new();
        Selected::start();
        let counter = Counter::new();
        hprintln!("floor of cycles, instructions, Cortex-M4F, counted by QEMU");
        let plate = (ThinPlate { amplitude: 0.03, range: 0.3 }, floor::THIN_PLATE);
        let matern = (Matern32 { amplitude: 0.03, lengthscale: 0.1 }, floor::MATERN);
        let point = Vector([0.03, 0.01, -0.02]);
        map(&counter, "thin plate in space by value", PLATE, plate, (point, false));
        map(&counter, "Matérn in the plane", PLANAR, matern, (Vector([0.03, 0.01]), true));
        map(&counter, "Matérn in space", SPATIAL, matern, (point, true));
        loop {
            debug::exit(debug::EXIT_SUCCESS);
        }
    }
}
