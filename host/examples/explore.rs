use rayon::prelude::*;
use std::path::PathBuf;
use std::sync::Arc;
use tactile_host::quantity::Deviation;
use tactile_host::reference::body::Body;
use tactile_host::reference::hyper::{Belief, Search};
use tactile_host::reference::{Contact, Faces, Gpis, Kernel, Mean, Prior, Training};
use tactile_host::shape::Field;
use tactile_host::sim::{ObjectSpec, Options, Touch, simulate};
use tactile_host::slam::{reconstruct::place, track};

struct Result1 {
    name: String,
    evidence: f64,
    amp: f64,
    len: f64,
    noise: f64,
    area: f64,
    rms: f64,
    p99: f64,
    max: f64,
    cover: f64,
    far_bad: f64,
    planes: usize,
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let seeds: u64 = args[1].parse().unwrap();
    let noise: f64 = args[2].parse().unwrap();
    let counts: Vec<usize> = args[3].split(',').map(|c| c.parse().unwrap()).collect();
    let ycb = PathBuf::from("/work/shared/data/ycb");
    for object in &args[4..] {
        let text = if object.ends_with(".ply") {
            ycb.join(object).display().to_string()
        } else {
            object.clone()
        };
        let spec: ObjectSpec = text.parse().unwrap();
        for &n in &counts {
            let all: Vec<Vec<Result1>> =
                (0..seeds).into_par_iter().map(|s| one(&spec, n, noise, 1000 + s)).collect();
            let names: Vec<String> = all[0].iter().map(|r| r.name.clone()).collect();
            let med = |mut v: Vec<f64>| {
                v.sort_by(f64::total_cmp);
                if v.is_empty() { f64::NAN } else { v[v.len() / 2] }
            };
            println!("{object} n={n} noise={noise}");
            for name in &names {
                let get = |f: &dyn Fn(&Result1) -> f64| {
                    med(all
                        .iter()
                        .filter_map(|a| a.iter().find(|r| &r.name == name))
                        .map(|r| f(r))
                        .collect())
                };
                let wins = all
                    .iter()
                    .filter(|a| {
                        a.iter()
                            .filter(|r| r.evidence.is_finite())
                            .max_by(|x, y| x.evidence.total_cmp(&y.evidence))
                            .map(|r| &r.name == name)
                            .unwrap_or(false)
                    })
                    .count();
                let present = all.iter().filter(|a| a.iter().any(|r| &r.name == name)).count();
                println!(
                    "  {name:14} wins {wins:3}/{present:<3} ev {:8.1} amp {:6.3} len {:6.2} noise {:5.2} lnA {:6.1} | rms {:6.2} p99 {:6.2} max {:6.2} | cover {:5.1} far bad {:5.1} | planes {:.0}",
                    get(&|r| r.evidence),
                    get(&|r| r.amp),
                    get(&|r| r.len),
                    get(&|r| r.noise),
                    get(&|r| r.area),
                    get(&|r| r.rms),
                    get(&|r| r.p99),
                    get(&|r| r.max),
                    get(&|r| r.cover),
                    get(&|r| r.far_bad),
                    get(&|r| r.planes as f64)
                );
            }
            // chosen by evidence
            let best = |a: &Vec<Result1>| {
                a.iter()
                    .enumerate()
                    .filter(|r| r.1.evidence.is_finite())
                    .max_by(|x, y| x.1.evidence.total_cmp(&y.1.evidence))
                    .map(|r| r.0)
                    .unwrap()
            };
            let oracle = |a: &Vec<Result1>| a.iter().map(|r| r.max).fold(f64::INFINITY, f64::min);
            println!(
                "  CHOSEN rms {:.2} p99 {:.2} max {:.2} cover {:.1} far bad {:.1}; oracle max {:.2}",
                med(all.iter().map(|a| a[best(a)].rms).collect()),
                med(all.iter().map(|a| a[best(a)].p99).collect()),
                med(all.iter().map(|a| a[best(a)].max).collect()),
                med(all.iter().map(|a| a[best(a)].cover).collect()),
                med(all.iter().map(|a| a[best(a)].far_bad).collect()),
                med(all.iter().map(oracle).collect())
            );
        }
    }
}

fn one(spec: &ObjectSpec, n: usize, noise: f64, seed: u64) -> Vec<Result1> {
    let contact_noise = Deviation {
        length: 1e-3 * noise,
        angle: (5.0 * if noise > 2.0 { 1.6 } else { noise }).to_radians(),
    };
    let options = Options {
        grasps: Some(1),
        contacts: n,
        touch: Touch::Uniform,
        seed,
        contact_noise,
        ..Options::new(spec.clone())
    };
    let simulation = simulate(&options).unwrap();
    let steps = track::truth(&simulation.log).unwrap();
    let contacts: Vec<Contact> = place(&simulation.log, &steps).iter().map(|p| p.contact).collect();
    let dim = simulation.log.dimension;
    let samples = simulation.geometry.samples(if dim == 2 { 400 } else { 800 });
    let ball = Prior::fitted(&contacts).unwrap();
    let Prior::Ball { radius, .. } = ball else { panic!() };
    let faces = Faces::fit(dim, &contacts);
    let mut means: Vec<(&str, Arc<dyn Mean>, f64, usize)> = vec![("old", ball.into(), f64::NAN, 0)];
    if let Some(b) = Body::ball(dim, &contacts) {
        let k = b.oddity();
        means.push(("ball", b.into(), k, 0));
    }
    if let Some(b) = Body::quadric(dim, &contacts) {
        let k = b.oddity();
        means.push(("quadric", b.into(), k, 0));
    }
    if let Some(faces) = &faces {
        if let Some(b) = Body::cut(dim, &contacts, faces) {
            let (k, p) = (b.oddity(), b.parts().len() - 1);
            means.push(("cut", b.into(), k, p));
        }
        let centre =
            contacts.iter().map(|c| c.point).sum::<tactile_host::space::Point>() / n as f64;
        let far = contacts.iter().map(|c| (c.point - centre).norm()).fold(0.0, f64::max);
        if tactile_host::shape::polytope::intersect(faces, &centre, 2.0 * far).is_some() {
            let b = Body::polytope(dim, &contacts, faces).unwrap();
            let (k, p) = (b.oddity(), b.parts().len());
            means.push(("polytope", b.into(), k, p));
        }
    }
    let mut out = vec![];
    let ballbelief = std::env::var("BALLBELIEF").is_ok();
    let kernels = std::env::var("KERNELS").unwrap_or("m32".into());
    {
        let (kernel, gpis) = tactile_host::slam::fit::fit(dim, &contacts, &[]).unwrap();
        let points: Vec<_> = samples.iter().map(|s| s.0).collect();
        let e = gpis.values(&points);
        let g = gpis.gradients(&points);
        let dev = gpis.deviations(&points);
        let mut d: Vec<f64> =
            e.iter().zip(&g).map(|(e, g)| 1e3 * e.abs() / g.norm().max(0.3)).collect();
        let (mut near, mut inb, mut far, mut bad) = (0.0, 0.0, 0.0f64, 0.0);
        for ((p, d), s) in points.iter().zip(&d).zip(&dev) {
            let r = gpis.nearest(p);
            let ok = *d <= 1.96e3 * s;
            if r < 0.01 {
                near += 1.0;
                if ok {
                    inb += 1.0
                }
            } else {
                far += 1.0;
                if !ok {
                    bad += 1.0
                }
            }
        }
        let rms = (d.iter().map(|d| d * d).sum::<f64>() / d.len() as f64).sqrt();
        d.sort_by(f64::total_cmp);
        let Kernel::Matern32 { amplitude, lengthscale } = kernel else { panic!() };
        out.push(Result1 {
            name: "FIT".into(),
            evidence: f64::NAN,
            amp: amplitude / radius,
            len: lengthscale / radius,
            noise: 0.0,
            area: 0.0,
            rms,
            p99: d[d.len() * 99 / 100],
            max: d[d.len() - 1],
            cover: 100.0 * inb / near,
            far_bad: 100.0 * bad / f64::max(far, 1.0),
            planes: 0,
        });
    }
    for (name, mean, k, planes) in means {
        for kernel in kernels.split(',') {
            let family = match kernel {
                "m32" => Kernel::Matern32 { amplitude: radius, lengthscale: radius },
                "m52" => Kernel::Matern52 { amplitude: radius, lengthscale: radius },
                _ => Kernel::SquaredExponential { amplitude: radius, lengthscale: radius },
            };
            let mut search = Search::default();
            if let Ok(m) = std::env::var("AMP") {
                let v: Vec<f64> = m.split(',').map(|x| x.parse().unwrap()).collect();
                search.amplitude = Belief { mode: v[0], deviation: v[1], bounds: (v[2], 10.0) };
            }
            if ballbelief && name == "ball" {
                search = Search::default();
            }
            if let Ok(m) = std::env::var("LEN") {
                let v: Vec<f64> = m.split(',').map(|x| x.parse().unwrap()).collect();
                search.lengthscale = Belief { mode: v[0], deviation: v[1], bounds: (0.1, 20.0) };
            }
            let stride = contacts.len().div_ceil(100);
            let deciding: Vec<Contact> = contacts.iter().step_by(stride).copied().collect();
            let Ok(found) =
                search.run(dim, family, mean.clone(), Training::Derivative, &deciding, radius)
            else {
                continue;
            };
            let noisy: Vec<Contact> = contacts.iter().map(|c| c.with_noise(found.noise)).collect();
            let Ok(gpis) = Gpis::fit(dim, found.kernel, mean.clone(), Training::Derivative, &noisy)
            else {
                continue;
            };
            let (amp, len) = match found.kernel {
                Kernel::Matern32 { amplitude, lengthscale }
                | Kernel::Matern52 { amplitude, lengthscale }
                | Kernel::SquaredExponential { amplitude, lengthscale } => {
                    (amplitude / radius, lengthscale / radius)
                }
                _ => (0.0, 0.0),
            };
            let lb = |b: Belief, x: f64| {
                -0.5 * ((x / b.mode).ln() / b.deviation).powi(2) - b.deviation.ln()
            };
            let prior = lb(search.amplitude, amp)
                + lb(search.lengthscale, len)
                + search.noise.map_or(0.0, |b| lb(b, found.noise));
            let area = 0.0 + surface_area(&gpis, &contacts, radius, dim);
            let evidence = found.log_likelihood + prior
                - k
                - area * std::env::var("AREA").map_or(0.0, |a| a.parse::<f64>().unwrap());
            let points: Vec<_> = samples.iter().map(|s| s.0).collect();
            let e = gpis.values(&points);
            let g = gpis.gradients(&points);
            let dev = gpis.deviations(&points);
            let mut d: Vec<f64> =
                e.iter().zip(&g).map(|(e, g)| 1e3 * e.abs() / g.norm().max(0.3)).collect();
            let (mut near, mut inb, mut far, mut bad) = (0.0, 0.0, 0.0f64, 0.0);
            for ((p, d), s) in points.iter().zip(&d).zip(&dev) {
                let r = gpis.nearest(p);
                let ok = *d <= 1.96e3 * s;
                if r < 0.01 {
                    near += 1.0;
                    if ok {
                        inb += 1.0
                    }
                } else {
                    far += 1.0;
                    if !ok {
                        bad += 1.0
                    }
                }
            }
            let rms = (d.iter().map(|d| d * d).sum::<f64>() / d.len() as f64).sqrt();
            d.sort_by(f64::total_cmp);
            out.push(Result1 {
                name: format!("{name} {kernel}"),
                evidence,
                amp,
                len,
                noise: found.noise,
                area,
                rms,
                p99: d[d.len() * 99 / 100],
                max: d[d.len() - 1],
                cover: 100.0 * inb / near,
                far_bad: 100.0 * bad / f64::max(far, 1.0),
                planes,
            });
        }
    }
    out
}

/// n ln(A/R^(d-1)) of the posterior zero set seen from the contacts' centre.
fn surface_area(gpis: &Gpis, contacts: &[Contact], radius: f64, dim: usize) -> f64 {
    use tactile_host::space::Point;
    let centre = contacts.iter().map(|c| c.point).sum::<Point>() / contacts.len() as f64;
    let m = if dim == 2 { 64 } else { 256 };
    let dirs: Vec<Point> = (0..m)
        .map(|i| {
            let u = (i as f64 + 0.5) / m as f64;
            if dim == 2 {
                let a = std::f64::consts::TAU * u;
                Point::new(a.cos(), a.sin(), 0.0)
            } else {
                let z = 2.0 * u - 1.0;
                let a = i as f64 * 2.399963;
                let r = (1.0 - z * z).sqrt();
                Point::new(r * a.cos(), r * a.sin(), z)
            }
        })
        .collect();
    let far = contacts.iter().map(|c| (c.point - centre).norm()).fold(0.0, f64::max);
    let steps = 24;
    let grid: Vec<Point> = dirs
        .iter()
        .flat_map(|d| (1..=steps).map(move |k| (*d, k)))
        .map(|(d, k)| centre + d * (2.0 * far * k as f64 / steps as f64))
        .collect();
    let v = gpis.values(&grid);
    let mut hits = vec![];
    for (d, f) in dirs.iter().zip(v.chunks(steps)) {
        let k = f.iter().position(|x| *x > 0.0);
        let r = match k {
            Some(0) => 0.5,
            Some(k) => k as f64 + f[k - 1].abs() / (f[k - 1].abs() + f[k]),
            None => steps as f64,
        } * 2.0
            * far
            / steps as f64;
        hits.push((*d, r));
    }
    let g = gpis.gradients(&hits.iter().map(|(d, r)| centre + d * *r).collect::<Vec<_>>());
    let a: f64 = hits
        .iter()
        .zip(&g)
        .map(|((d, r), g)| {
            let cos = (d.dot(g) / g.norm()).max(0.2);
            (r / radius).powi(dim as i32 - 1) / cos
        })
        .sum::<f64>()
        / m as f64;
    contacts.len() as f64 * a.ln()
}
