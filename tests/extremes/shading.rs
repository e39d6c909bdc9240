//! Row 22: the GGX lobe from mirror to matt: no NaN, no more light out than in.

use nalgebra::{Point3, Vector3};
use vergence_geom::View;
use vergence_scene::model::{Material, Scene, Shading};

use crate::stage::{NEAR_M, add, add_sun, looking, square, square_fov};
use crate::table::Table;
use vergence_tests::pictures::Bench;

/// How much more light may come out than goes in.
const EXCESS_BOUND: f64 = 1e-3;
const SIZE: (u32, u32) = (16, 16);
/// Lights of one picture; the renderer takes 64.
const LIGHTS: u32 = 64;
/// Pictures whose mean is taken.
const PICTURES: u32 = 32;

fn metal(roughness: f32, metallic: f32) -> Material {
    let shading = Shading::MetallicRoughness { metallic, roughness, texture: None, ior: 1.5 };
    Material { shading, ..Material::default() }
}

/// The middle of a white square, seen at an angle whose cosine is `cosine`.
fn stage(material: Material, cosine: f64) -> (Scene, View, Vector3<f64>) {
    let mut scene = Scene::default();
    let mut primitive = square();
    primitive.colors.clear();
    add(&mut scene, vergence_geom::Affine::identity(), primitive, material);
    let to_eye = Vector3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
    let view = looking(&Point3::from(to_eye), &Point3::origin(), square_fov(0.01));
    (scene, view, to_eye)
}

/// The brightest of all numbers of the middle pixel; NaN where one of the picture is not finite or negative.
fn middle(bench: &mut Bench, scene: &Scene, view: View) -> f64 {
    let shot = bench.shoot(scene, NEAR_M, SIZE, &[view]);
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            if !shot.color(0, x, y).iter().all(|c| c.is_finite() && *c >= 0.0) {
                return f64::NAN;
            }
        }
    }
    shot.color(0, SIZE.0 / 2, SIZE.1 / 2)[..3].iter().map(|c| f64::from(*c)).fold(0.0, f64::max)
}

/// Light out for light 1 in from everywhere (the ambient term).
fn ambient_furnace(bench: &mut Bench, material: Material, cosine: f64) -> f64 {
    let (mut scene, view, _) = stage(material, cosine);
    // Radiance 1 from everywhere is irradiance π.
    scene.ambient = [std::f32::consts::PI; 3];
    middle(bench, &scene, view)
}

/// Light out for light 1 in from everywhere, by lights at infinity placed where the lobe looks to: directions about
/// visible normals (Heitz 2018) and half of them about the cosine; their strength makes the mean the integral.
fn lights_furnace(bench: &mut Bench, material: &Material, roughness: f64, cosine: f64) -> f64 {
    let alpha = roughness * roughness;
    let total = LIGHTS * PICTURES;
    let mut sum = 0.0;
    for picture in 0..PICTURES {
        let (mut scene, view, to_eye) = stage(material.clone(), cosine);
        for light in 0..LIGHTS {
            let i = picture + light * PICTURES;
            // Additive recurrence of the plastic number: even in the square.
            let (a, b) = (
                (0.5 + f64::from(i) * 0.754_877_666_246_693).fract(),
                (0.5 + f64::from(i) * 0.569_840_290_998_053).fract(),
            );
            let direction = if i.is_multiple_of(2) {
                about_visible_normal(&to_eye, alpha, a, b)
            } else {
                about_cosine(a, b)
            };
            if direction.z <= 1e-9 {
                continue;
            }
            let density = 0.5 * visible_normal_density(&to_eye, &direction, alpha)
                + 0.5 * direction.z / std::f64::consts::PI;
            let strength = 1.0 / (density * f64::from(total));
            add_sun(&mut scene, &direction, [1.0; 3], strength as f32);
        }
        sum += middle(bench, &scene, view);
    }
    sum
}

fn about_cosine(a: f64, b: f64) -> Vector3<f64> {
    let (radius, turn) = (a.sqrt(), std::f64::consts::TAU * b);
    Vector3::new(radius * turn.cos(), radius * turn.sin(), (1.0 - a).sqrt())
}

/// Heitz, "Sampling the GGX Distribution of Visible Normals" (2018), mirrored about the normal found.
fn about_visible_normal(to_eye: &Vector3<f64>, alpha: f64, a: f64, b: f64) -> Vector3<f64> {
    let stretched = Vector3::new(alpha * to_eye.x, alpha * to_eye.y, to_eye.z).normalize();
    let t1 = Vector3::z().cross(&stretched).try_normalize(1e-12).unwrap_or_else(Vector3::x);
    let t2 = stretched.cross(&t1);
    let (radius, turn) = (a.sqrt(), std::f64::consts::TAU * b);
    let (x, mut y) = (radius * turn.cos(), radius * turn.sin());
    let s = 0.5 * (1.0 + stretched.z);
    y = (1.0 - s) * (1.0 - x * x).sqrt() + s * y;
    let n = x * t1 + y * t2 + (1.0 - x * x - y * y).max(0.0).sqrt() * stretched;
    let half_way = Vector3::new(alpha * n.x, alpha * n.y, n.z.max(0.0)).normalize();
    2.0 * to_eye.dot(&half_way) * half_way - to_eye
}

fn visible_normal_density(to_eye: &Vector3<f64>, direction: &Vector3<f64>, alpha: f64) -> f64 {
    let half_way = (to_eye + direction).normalize();
    let a2 = alpha * alpha;
    let across2 = half_way.x * half_way.x + half_way.y * half_way.y;
    let d = a2 / (std::f64::consts::PI * (half_way.z * half_way.z * a2 + across2).powi(2));
    let tan2 = (1.0 - to_eye.z * to_eye.z) / (to_eye.z * to_eye.z);
    let g1 = 2.0 / (1.0 + (1.0 + a2 * tan2).sqrt());
    g1 * d / (4.0 * to_eye.z)
}

pub fn run(bench: &mut Bench, table: &mut Table) {
    let cosines = [1.0, 0.7, 0.3, 0.05, 1e-3];
    let (mut not_finite, mut brightest_metal, mut brightest_plastic) = (0u32, 0.0f64, 0.0f64);
    for roughness in [0.0, 1e-4, 1e-3, 1e-2, 0.03, 0.1, 0.3, 0.6, 1.0] {
        for metallic in [0.0, 1.0] {
            for cosine in cosines {
                let brightest = if metallic == 0.0 { &mut brightest_plastic } else { &mut brightest_metal };
                for base in [0.0, 1.0] {
                    let material =
                        Material { base_color: [base, base, base, 1.0], ..metal(roughness, metallic) };
                    let out = ambient_furnace(bench, material, cosine);
                    not_finite += u32::from(out.is_nan());
                    *brightest = brightest.max(out);
                }
                // One light in the mirror direction: the peak of the lobe, where f32 overflows if anywhere.
                let (mut scene, view, to_eye) = stage(metal(roughness, metallic), cosine);
                add_sun(&mut scene, &Vector3::new(-to_eye.x, 0.0, to_eye.z), [1.0; 3], 1e5);
                add_sun(&mut scene, &Vector3::new(1.0, 0.0, 0.0), [1.0; 3], 1e5);
                not_finite += u32::from(middle(bench, &scene, view).is_nan());
            }
        }
    }
    table.check(
        "roughness 0 and 1e-4 to 1, pictures with NaN, infinity or negative",
        f64::from(not_finite),
        0.0,
        "",
    );
    table.check("white furnace, ambient, metal", brightest_metal - 1.0, EXCESS_BOUND, "excess");
    table.check("white furnace, ambient, plastic", brightest_plastic - 1.0, EXCESS_BOUND, "excess");
    for roughness in [0.01, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0] {
        for (metallic, name) in [(1.0, "metal"), (0.0, "plastic")] {
            let material = metal(roughness as f32, metallic);
            let energies =
                [1.0, 0.7, 0.3, 0.1].map(|cosine| lights_furnace(bench, &material, roughness, cosine));
            let worst = energies.iter().fold(0.0f64, |w, e| if e.is_nan() { *e } else { w.max(*e) });
            let least = energies.iter().fold(f64::INFINITY, |w, e| w.min(*e));
            let case = format!("white furnace, lights, {name}, roughness {roughness}");
            assert!(least > 0.2, "{case}: too dark to be a furnace: {least}");
            table.check(case, worst - 1.0, EXCESS_BOUND, "excess");
        }
    }
}
