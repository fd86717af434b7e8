//! Our SIFT compared with OpenCV's, an independent implementation, on the same picture (`tests/fixtures/README.md`).

use hdralign::align::features::sift::{SiftOptions, detect};
use hdralign::align::features::{Descriptors, Keypoint, SiftDescriptor};
use hdralign::plane::Plane;
use std::path::Path;

/// A keypoint that OpenCV found, in our units, with its descriptor.
struct Theirs {
    point: Keypoint,
    descriptor: Option<SiftDescriptor>,
}

fn fixture(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

fn picture() -> Plane<u8> {
    let grey = image::open(fixture("sift.png")).unwrap().into_luma8();
    let (width, height) = grey.dimensions();
    Plane::from_vec(width as usize, height as usize, grey.into_raw())
}

fn theirs() -> Vec<Theirs> {
    let text = std::fs::read_to_string(fixture("sift.json")).unwrap();
    let rows: Vec<serde_json::Value> = serde_json::from_str(&text).unwrap();
    let number = |v: &serde_json::Value| v.as_f64().unwrap() as f32;
    rows.iter()
        .map(|row| {
            let [x, y, size, degrees, response] = std::array::from_fn(|i| number(&row["point"][i]));
            let angle = if degrees > 180.0 { degrees - 360.0 } else { degrees }.to_radians();
            let point = Keypoint { x, y, scale: size / 2.0, angle, response, bright: true };
            let descriptor =
                row.get("descriptor").map(|d| std::array::from_fn(|i| d[permuted(i)].as_u64().unwrap() as u8));
            Theirs { point, descriptor }
        })
        .collect()
}

/// Returns the position of our entry `i` in OpenCV's descriptor: it has the same cell, but its directions run from +y
/// towards +x.
fn permuted(i: usize) -> usize {
    i / 8 * 8 + (8 - i % 8) % 8
}

fn apart(a: &Keypoint, b: &Keypoint) -> f32 {
    (a.x - b.x).hypot(a.y - b.y)
}

/// Returns whether two keypoints are within a pixel of each other, and their scales within a factor of 1.2.
fn same_place(a: &Keypoint, b: &Keypoint) -> bool {
    apart(a, b) < 1.0 && a.scale < 1.2 * b.scale && b.scale < 1.2 * a.scale
}

/// Returns the angle between the directions of two keypoints, in degrees.
fn turn(a: &Keypoint, b: &Keypoint) -> f32 {
    let turn = (a.angle - b.angle).to_degrees().rem_euclid(360.0);
    turn.min(360.0 - turn)
}

fn share(yes: usize, of: usize) -> f64 {
    yes as f64 / of as f64
}

#[test]
fn both_find_the_same_places_scales_and_directions() {
    let ours = detect(&picture(), &SiftOptions::default()).keypoints;
    let theirs: Vec<Keypoint> = theirs().into_iter().map(|t| t.point).collect();
    let found = |list: &[Keypoint], p: &Keypoint| list.iter().any(|q| same_place(p, q));
    let theirs_found = theirs.iter().filter(|p| found(&ours, p)).count();
    let ours_found = ours.iter().filter(|p| found(&theirs, p)).count();
    let recall = (share(theirs_found, theirs.len()), share(ours_found, ours.len()));
    let directed = theirs.iter().filter(|p| ours.iter().any(|q| same_place(p, q) && turn(p, q) < 10.0)).count();
    let mut distances: Vec<(f32, f32, f32)> = theirs
        .iter()
        .filter_map(|p| {
            let near = ours.iter().filter(|q| same_place(p, q));
            near.min_by(|a, b| apart(a, p).total_cmp(&apart(b, p))).map(|q| (apart(q, p), q.x - p.x, q.y - p.y))
        })
        .collect();
    distances.sort_by(|a, b| a.0.total_cmp(&b.0));
    let median = distances[distances.len() / 2].0;
    let mean = |f: fn(&(f32, f32, f32)) -> f32| distances.iter().map(f).sum::<f32>() / distances.len() as f32;
    println!(
        "{} ours, {} theirs; {recall:?} found; directions {}; median {median} px; mean {} {} px",
        ours.len(),
        theirs.len(),
        share(directed, theirs_found),
        mean(|d| d.1),
        mean(|d| d.2)
    );
    assert!(theirs.len() > 200);
    assert!(recall.0 > 0.85 && recall.1 > 0.85, "{recall:?}");
    assert!(share(directed, theirs_found) > 0.9);
    // Both implementations fit the same quadratic, with nearly the same result. Another convention for coordinates
    // would shift the positions by a quarter of a pixel or more.
    assert!(median < 0.1 && mean(|d| d.1).abs() < 0.1 && mean(|d| d.2).abs() < 0.1);
}

#[test]
fn descriptors_of_the_same_places_find_each_other() {
    let ours = detect(&picture(), &SiftOptions::default());
    let theirs: Vec<(Keypoint, SiftDescriptor)> =
        theirs().into_iter().filter_map(|t| t.descriptor.map(|d| (t.point, d))).collect();
    let Descriptors::Sift(descriptors) = &ours.descriptors else { panic!("descriptors of SIFT") };
    let distance = |a: &SiftDescriptor, b: &SiftDescriptor| -> i64 {
        a.iter().zip(b).map(|(p, q)| (i64::from(*p) - i64::from(*q)).pow(2)).sum()
    };
    // OpenCV returns only a part of its keypoints, and we return all of ours: only keypoints that both found are
    // matched, as mutual nearest neighbours.
    let common: Vec<&(Keypoint, SiftDescriptor)> =
        theirs.iter().filter(|t| ours.keypoints.iter().any(|p| same_place(p, &t.0) && turn(p, &t.0) < 10.0)).collect();
    let (mut right, mut matched, mut close) = (0, 0, 0);
    for (point, descriptor) in &common {
        let nearest = (0..ours.len()).min_by_key(|&i| distance(&descriptors[i], descriptor)).unwrap();
        let back = common.iter().min_by_key(|t| distance(&descriptors[nearest], &t.1)).unwrap();
        if back.0 == *point {
            matched += 1;
            right += usize::from(same_place(&ours.keypoints[nearest], point));
            close += usize::from(distance(&descriptors[nearest], descriptor) < 100 * 100);
        }
    }
    println!("{} in common, {matched} mutual, {right} right, {close} within 100 of 512", common.len());
    assert!(common.len() > 60);
    assert!(share(matched, common.len()) > 0.9 && share(right, matched) > 0.9);
    // A distance below 100 shows that both descriptors have the same layout: descriptors of length 512 without common
    // entries have a distance of sqrt(2) * 512.
    assert!(share(close, matched) > 0.8);
}
