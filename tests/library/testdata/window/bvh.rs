//! A tree of bounding volumes over the triangles of the scene. It finds the nearest hit of a ray, or whether anything
//! blocks the ray.

use super::mesh::Triangle;
use super::vec3::{V3, v3};

/// Where a ray meets a triangle.
#[derive(Clone, Copy)]
pub struct Hit {
    pub t: f32,
    pub triangle: u32,
    pub u: f32,
    pub v: f32,
}

#[derive(Clone, Copy)]
struct Node {
    lo: V3,
    hi: V3,
    /// Index of the first triangle of a leaf, or of the second child of an inner node (the first child is the next
    /// node).
    next: u32,
    /// Number of triangles of a leaf; 0 for an inner node.
    count: u32,
}

/// The part of a triangle that is needed to intersect it with a ray.
#[derive(Clone, Copy)]
struct Face {
    at: V3,
    e1: V3,
    e2: V3,
}

/// The tree, with the triangles in the order of its leaves.
pub struct Bvh {
    nodes: Vec<Node>,
    faces: Vec<Face>,
    pub triangles: Vec<Triangle>,
}

const LEAF: usize = 4;
const BINS: usize = 16;

fn bounds(t: &Triangle) -> (V3, V3) {
    let [a, b, c] = t.corners;
    (a.at.min(b.at).min(c.at), a.at.max(b.at).max(c.at))
}

fn half_area(lo: V3, hi: V3) -> f32 {
    let d = (hi - lo).max(V3::ZERO);
    d.x * d.y + d.y * d.z + d.z * d.x
}

impl Bvh {
    pub fn new(mut triangles: Vec<Triangle>) -> Bvh {
        let mut nodes = Vec::new();
        let n = triangles.len();
        split(&mut triangles, 0, n, &mut nodes);
        let faces = triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.corners;
                Face { at: a.at, e1: b.at - a.at, e2: c.at - a.at }
            })
            .collect();
        Bvh { nodes, faces, triangles }
    }

    /// Returns the nearest hit along `o + t d` with `t` in 0.0001..`limit`, of the triangles for whose index `keep`
    /// returns true.
    pub fn nearest(&self, o: V3, d: V3, limit: f32, keep: impl Fn(u32) -> bool) -> Option<Hit> {
        let mut best = None;
        self.walk(o, d, limit, |hit| {
            if keep(hit.triangle) {
                best = Some(hit);
                Some(hit.t)
            } else {
                None
            }
        });
        best
    }

    /// Returns whether there is a triangle between `o` and `o + limit d` for whose index `keep` returns true.
    pub fn blocked(&self, o: V3, d: V3, limit: f32, keep: impl Fn(u32) -> bool) -> bool {
        let mut found = false;
        self.walk(o, d, limit, |hit| {
            if keep(hit.triangle) {
                found = true;
                Some(-1.0)
            } else {
                None
            }
        });
        found
    }

    /// Calls `visit` for hits nearer than `limit`. `visit` may return a new, lower limit; a negative one ends the walk.
    fn walk(&self, o: V3, d: V3, mut limit: f32, mut visit: impl FnMut(Hit) -> Option<f32>) {
        let inv = v3(1.0 / d.x, 1.0 / d.y, 1.0 / d.z);
        let mut stack = [0u32; 64];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let index = stack[top];
            let node = &self.nodes[index as usize];
            if entry(node, o, inv, limit).is_none() {
                continue;
            }
            if node.count == 0 {
                let (a, b) = (index + 1, node.next);
                let (ta, tb) =
                    (entry(&self.nodes[a as usize], o, inv, limit), entry(&self.nodes[b as usize], o, inv, limit));
                match (ta, tb) {
                    (Some(x), Some(y)) => {
                        (stack[top], stack[top + 1]) = if x < y { (b, a) } else { (a, b) };
                        top += 2;
                    }
                    (Some(_), None) => {
                        stack[top] = a;
                        top += 1;
                    }
                    (None, Some(_)) => {
                        stack[top] = b;
                        top += 1;
                    }
                    (None, None) => {}
                }
                continue;
            }
            for i in node.next..node.next + node.count {
                if let Some(hit) = meet(&self.faces[i as usize], i, o, d, limit)
                    && let Some(new) = visit(hit)
                {
                    limit = new;
                    if limit < 0.0 {
                        return;
                    }
                }
            }
        }
    }
}

fn entry(node: &Node, o: V3, inv: V3, limit: f32) -> Option<f32> {
    let (a, b) = ((node.lo - o) * inv, (node.hi - o) * inv);
    let (near, far) = (a.min(b), a.max(b));
    let enter = near.x.max(near.y).max(near.z).max(0.0);
    let leave = far.x.min(far.y).min(far.z).min(limit);
    (enter <= leave * 1.000_001).then_some(enter)
}

/// Intersects a ray with a triangle, by the method of Möller and Trumbore.
fn meet(f: &Face, triangle: u32, o: V3, d: V3, limit: f32) -> Option<Hit> {
    let p = d.cross(f.e2);
    let det = f.e1.dot(p);
    if det.abs() < 1e-12 {
        return None;
    }
    let (inv, s) = (1.0 / det, o - f.at);
    let u = s.dot(p) * inv;
    if !(0.0..=1.0).contains(&u) {
        return None;
    }
    let q = s.cross(f.e1);
    let v = d.dot(q) * inv;
    let t = f.e2.dot(q) * inv;
    (v >= 0.0 && u + v <= 1.0 && t > 1e-4 && t < limit).then_some(Hit { t, triangle, u, v })
}

/// Splits `triangles[from..to]` by the binned surface-area heuristic, and appends the nodes.
fn split(triangles: &mut [Triangle], from: usize, to: usize, nodes: &mut Vec<Node>) {
    let (mut lo, mut hi) = (V3::ONE * f32::INFINITY, V3::ONE * f32::NEG_INFINITY);
    let (mut clo, mut chi) = (lo, hi);
    for t in &triangles[from..to] {
        let (a, b) = bounds(t);
        (lo, hi) = (lo.min(a), hi.max(b));
        (clo, chi) = (clo.min(a + b), chi.max(a + b));
    }
    let me = nodes.len();
    nodes.push(Node { lo, hi, next: from as u32, count: (to - from) as u32 });
    if to - from <= LEAF {
        return;
    }
    let mut best = (f32::INFINITY, 0, 0);
    let bin_of = |t: &Triangle, axis: usize| {
        let (a, b) = bounds(t);
        let s = ((a + b).axis(axis) - clo.axis(axis)) / (chi.axis(axis) - clo.axis(axis));
        ((s * BINS as f32) as usize).min(BINS - 1)
    };
    for axis in 0..3 {
        if chi.axis(axis) - clo.axis(axis) < 1e-6 {
            continue;
        }
        let mut bins = [(V3::ONE * f32::INFINITY, V3::ONE * f32::NEG_INFINITY, 0usize); BINS];
        for t in &triangles[from..to] {
            let (bin, (a, b)) = (&mut bins[bin_of(t, axis)], bounds(t));
            *bin = (bin.0.min(a), bin.1.max(b), bin.2 + 1);
        }
        for cut in 1..BINS {
            let side = |part: &[(V3, V3, usize)]| {
                let s = part.iter().fold((V3::ONE * f32::INFINITY, V3::ONE * f32::NEG_INFINITY, 0), |s, b| {
                    (s.0.min(b.0), s.1.max(b.1), s.2 + b.2)
                });
                (if s.2 == 0 { 0.0 } else { half_area(s.0, s.1) * s.2 as f32 }, s.2)
            };
            let ((a, na), (b, nb)) = (side(&bins[..cut]), side(&bins[cut..]));
            if na > 0 && nb > 0 && a + b < best.0 {
                best = (a + b, axis, cut);
            }
        }
    }
    let middle = if best.0.is_finite() {
        let part = &mut triangles[from..to];
        // The partition is stable, so that triangles have the same order, and ties the same result, each time.
        part.sort_by_key(|t| bin_of(t, best.1) >= best.2);
        from + part.partition_point(|t| bin_of(t, best.1) < best.2)
    } else {
        (from + to) / 2
    };
    split(triangles, from, middle, nodes);
    let second = nodes.len() as u32;
    split(triangles, middle, to, nodes);
    nodes[me].next = second;
    nodes[me].count = 0;
}
