//! A small software rasteriser: shaded triangles into a depth buffer, seen without perspective.

use super::canvas::{Frame, Pixel};
use super::colour::Colour;
use crate::space::Point;

/// Pixels drawn per picture pixel along each axis, averaged at the end.
const OVERSAMPLING: usize = 2;

/// Where the viewer stands: three unit vectors, and how metres map to pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Camera {
    right: Point,
    up: Point,
    /// From the object to the viewer.
    towards: Point,
    middle: Point,
    /// Pixels per metre.
    pub scale: f64,
    frame: Frame,
}

impl Camera {
    /// Looks at the box `bounds` from the direction `towards`, filling `frame`.
    pub fn new(towards: Point, bounds: (Point, Point), frame: Frame) -> Self {
        let towards = towards.normalize();
        let vertical = if towards.z.abs() > 0.99 { Point::y() } else { Point::z() };
        let right = vertical.cross(&towards).normalize();
        let up = towards.cross(&right);
        let half = (bounds.1 - bounds.0) / 2.0;
        let reach = |axis: &Point| axis.abs().dot(&half).max(1e-6);
        let scale = (f64::from(frame.width) / 2.0 / reach(&right))
            .min(f64::from(frame.height) / 2.0 / reach(&up));
        Self { right, up, towards, middle: (bounds.0 + bounds.1) / 2.0, scale, frame }
    }

    /// Pixel in the picture, and metres towards the viewer.
    pub fn project(&self, p: &Point) -> (Pixel, f64) {
        let offset = p - self.middle;
        let x = self.frame.left + self.frame.width / 2.0;
        let y = self.frame.top + self.frame.height / 2.0;
        let across = (offset.dot(&self.right) * self.scale) as f32;
        let up = (offset.dot(&self.up) * self.scale) as f32;
        ([x + across, y - up], offset.dot(&self.towards))
    }

    /// A direction's pixels per unit length.
    pub fn direction(&self, d: &Point) -> Pixel {
        [d.dot(&self.right) as f32, -d.dot(&self.up) as f32]
    }

    /// Whether a surface with this outward normal faces the viewer.
    pub fn sees(&self, normal: &Point) -> bool {
        normal.dot(&self.towards) > 0.0
    }

    /// How brightly a surface with this unit normal shows: a lamp above the viewer's left shoulder,
    /// and some light from everywhere.
    pub fn brightness(&self, normal: &Point) -> f32 {
        let lamp = (self.towards + self.up * 0.8 - self.right * 0.6).normalize();
        (0.70 + 0.42 * normal.dot(&lamp).max(0.0)) as f32
    }
}

/// A corner of a triangle to draw.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corner {
    pub pixel: Pixel,
    pub depth: f64,
    pub colour: Colour,
}

/// Colours and depths over a frame.
pub(super) struct Raster {
    frame: Frame,
    width: usize,
    height: usize,
    colours: Vec<[f32; 4]>,
    depths: Vec<f64>,
}

impl Raster {
    pub fn new(frame: Frame) -> Self {
        let side = |pixels: f32| pixels.max(1.0).ceil() as usize * OVERSAMPLING;
        let (width, height) = (side(frame.width), side(frame.height));
        Self {
            frame,
            width,
            height,
            colours: vec![[0.0; 4]; width * height],
            depths: vec![f64::NEG_INFINITY; width * height],
        }
    }

    /// Picture pixels to samples.
    fn sample(&self, pixel: Pixel) -> [f64; 2] {
        let fine = OVERSAMPLING as f64;
        [f64::from(pixel[0] - self.frame.left) * fine, f64::from(pixel[1] - self.frame.top) * fine]
    }

    /// Fills a triangle, interpolating its corners, where it is nearest to the viewer.
    pub fn triangle(&mut self, corners: [Corner; 3]) {
        let [a, b, c] = corners.map(|c| self.sample(c.pixel));
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if !(area.is_finite() && area.abs() > 1e-12) {
            return;
        }
        let range = |axis: usize, end: usize| {
            let least = a[axis].min(b[axis]).min(c[axis]).floor().max(0.0) as usize;
            let most = a[axis].max(b[axis]).max(c[axis]).ceil().max(0.0) as usize;
            least..most.min(end)
        };
        for y in range(1, self.height) {
            for x in range(0, self.width) {
                let p = [x as f64 + 0.5, y as f64 + 0.5];
                let side = |u: [f64; 2], v: [f64; 2]| {
                    ((v[0] - u[0]) * (p[1] - u[1]) - (v[1] - u[1]) * (p[0] - u[0])) / area
                };
                let shares = [side(b, c), side(c, a), side(a, b)];
                if shares.iter().any(|s| *s < -1e-9) {
                    continue;
                }
                let mix = |of: &dyn Fn(&Corner) -> f64| -> f64 {
                    corners.iter().zip(shares).map(|(c, s)| of(c) * s).sum()
                };
                let depth = mix(&|c| c.depth);
                let at = y * self.width + x;
                if depth > self.depths[at] {
                    self.depths[at] = depth;
                    self.colours[at] =
                        std::array::from_fn(|i| mix(&|c| f64::from(c.colour.0[i])) as f32);
                }
            }
        }
    }

    /// Whether something at this pixel and depth lies more than `slack` metres behind what was
    /// drawn.
    pub fn hides(&self, pixel: Pixel, depth: f64, slack: f64) -> bool {
        let [x, y] = self.sample(pixel);
        if !(x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64) {
            return false;
        }
        self.depths[y as usize * self.width + x as usize] > depth + slack
    }

    /// The picture in straight RGBA, row by row, and its width.
    pub fn picture(&self) -> (u32, Vec<[f32; 4]>) {
        let (width, height) = (self.width / OVERSAMPLING, self.height / OVERSAMPLING);
        let mut rows = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let mut sum = [0.0f32; 4];
                for sample in 0..OVERSAMPLING * OVERSAMPLING {
                    let (dx, dy) = (sample % OVERSAMPLING, sample / OVERSAMPLING);
                    let at = (y * OVERSAMPLING + dy) * self.width + x * OVERSAMPLING + dx;
                    let c = self.colours[at];
                    for i in 0..3 {
                        sum[i] += c[i] * c[3];
                    }
                    sum[3] += c[3];
                }
                let cover = sum[3].max(1e-6);
                let whole = (OVERSAMPLING * OVERSAMPLING) as f32;
                rows.push([sum[0] / cover, sum[1] / cover, sum[2] / cover, sum[3] / whole]);
            }
        }
        (width as u32, rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Frame = Frame { left: 10.0, top: 20.0, width: 40.0, height: 40.0 };

    fn camera(towards: Point) -> Camera {
        Camera::new(towards, (Point::repeat(-1.0), Point::repeat(1.0)), FRAME)
    }

    #[test]
    fn from_above_x_goes_right_and_y_up() {
        let camera = camera(Point::z());
        let (pixel, depth) = camera.project(&Point::new(1.0, 0.5, 0.25));
        assert!((pixel[0] - 50.0).abs() < 1e-4 && (pixel[1] - 30.0).abs() < 1e-4, "{pixel:?}");
        assert_eq!(depth, 0.25);
        assert!(camera.sees(&Point::z()) && !camera.sees(&-Point::z()));
    }

    #[test]
    fn from_the_front_x_goes_right_and_z_up() {
        let (pixel, depth) = camera(-Point::y()).project(&Point::new(0.5, 0.25, 1.0));
        assert!((pixel[0] - 40.0).abs() < 1e-4 && (pixel[1] - 20.0).abs() < 1e-4, "{pixel:?}");
        assert_eq!(depth, -0.25);
    }

    #[test]
    fn the_nearest_triangle_shows_whatever_the_order() {
        let corner = |x, y, depth, colour| Corner { pixel: [x, y], depth, colour };
        let (red, blue) = (Colour([1.0, 0.0, 0.0, 1.0]), Colour([0.0, 0.0, 1.0, 1.0]));
        let triangle = |depth, colour| {
            [[10.0, 20.0], [50.0, 20.0], [10.0, 60.0]].map(|p| corner(p[0], p[1], depth, colour))
        };
        for order in [[0, 1], [1, 0]] {
            let both = [triangle(0.0, red), triangle(0.5, blue)];
            let mut raster = Raster::new(FRAME);
            order.iter().for_each(|i| raster.triangle(both[*i]));
            let (width, rows) = raster.picture();
            assert_eq!((width, rows.len()), (40, 1600));
            assert_eq!(rows[5 * 40 + 5], [0.0, 0.0, 1.0, 1.0]);
            assert_eq!(rows[39 * 40 + 39][3], 0.0);
            assert!(raster.hides([15.0, 25.0], 0.2, 0.1));
            assert!(!raster.hides([15.0, 25.0], 0.45, 0.1));
            assert!(!raster.hides([49.0, 59.0], 0.0, 0.1));
            assert!(!raster.hides([0.0, 0.0], 0.0, 0.1));
        }
    }
}
