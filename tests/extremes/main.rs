//! Stable at the extremes: each case is drawn by the renderer, measured in its picture, and printed with its bound.
//!
//! Pictures have 32-bit floating-point colours, so that what is measured is the arithmetic, not eight bits. Where
//! validation is installed, it is on, and any message fails.

mod depth;
mod far;
mod normals;
mod projection;
mod shading;
mod stage;
mod table;

use table::Table;
use vergence_tests::pictures::Bench;

fn measured(title: &str, run: impl FnOnce(&mut Bench, &mut Table)) {
    let Some(mut bench) = Bench::open() else { return };
    let mut table = Table::default();
    run(&mut bench, &mut table);
    assert_eq!(bench.complaints(), Vec::<String>::new());
    table.finish(&format!("{title}, on {}", bench.device_name()));
}

#[test]
fn depth_is_told_apart() {
    measured("depth", depth::run);
}

#[test]
fn far_from_the_origin_is_the_same() {
    let Some(data) = vergence_tests::data() else { return };
    measured("far from the origin", |bench, table| far::run(bench, table, &data));
}

#[test]
fn normals_stand_upright() {
    measured("normals", normals::run);
}

#[test]
fn shading_keeps_its_energy() {
    measured("shading", shading::run);
}

#[test]
fn points_land_where_they_should() {
    measured("projection", projection::run);
}
