//! The scene: triangles, materials, the window as a portal for light, and the camera that looks at it.

use super::bvh::Bvh;
use super::mesh::Mesh;
use super::outdoors;
use super::paint::{Finish, Material, Paint};
use super::vec3::{V3, v3};

/// Width of a frame in pixels.
pub const WIDTH: usize = 1200;
/// Height of a frame in pixels.
pub const HEIGHT: usize = 800;

/// Focal length in pixels, for 24 mm on a sensor of 36 mm width.
pub const FOCAL: f64 = WIDTH as f64 * 24.0 / 36.0;

/// The x of the left wall, in metres.
pub const LEFT: f32 = -2.7;
/// The x of the right wall, in metres.
pub const RIGHT: f32 = 2.7;
/// The z of the wall behind the camera, in metres.
pub const BACK: f32 = -2.0;
/// The z of the wall with the window, in metres.
pub const FRONT: f32 = 5.0;
/// The y of the ceiling, in metres; the floor is at 0.
pub const CEILING: f32 = 2.8;

/// The window in the front wall: smallest x, largest x, smallest y and largest y, in metres.
pub const WINDOW: [f32; 4] = [-1.72, 1.28, 0.62, 2.46];
/// The z of the plane outside of the window through which light enters, in metres.
pub const OUTSIDE: f32 = 5.26;

/// Meshes and materials while the scene is being built.
#[derive(Default)]
pub struct Builder {
    pub mesh: Mesh,
    pub materials: Vec<Material>,
}

impl Builder {
    /// Adds a material and returns its index.
    pub fn material(&mut self, paint: Paint, finish: Finish) -> u16 {
        self.materials.push(Material { paint, finish });
        (self.materials.len() - 1) as u16
    }

    /// Adds a matt material in one colour and returns its index.
    pub fn plain(&mut self, r: f32, g: f32, b: f32) -> u16 {
        self.material(Paint::Plain(v3(r, g, b)), Finish::Matt)
    }
}

/// Everything that a light path needs.
pub struct Scene {
    pub bvh: Bvh,
    pub materials: Vec<Material>,
    sky: Vec<V3>,
}

const SKY_W: usize = 192;
const SKY_H: usize = 128;

impl Scene {
    pub fn new() -> Scene {
        let mut b = Builder::default();
        super::room::build(&mut b);
        super::furniture::build(&mut b);
        super::still_life::build(&mut b);
        let sky = (0..SKY_W * SKY_H)
            .map(|k| {
                let (i, j) = (k % SKY_W, k / SKY_W);
                // The mean of four directions is enough, because this map is only used for lighting and is never
                // visible.
                (0..4).fold(V3::ZERO, |sum, q| {
                    let (u, v) = (
                        (i as f32 + 0.25 + 0.5 * (q % 2) as f32) / SKY_W as f32,
                        (j as f32 + 0.25 + 0.5 * (q / 2) as f32) / SKY_H as f32,
                    );
                    let (az, el) = ((u - 0.5) * std::f32::consts::PI, (v - 0.5) * std::f32::consts::PI);
                    sum + outdoors::radiance(v3(el.cos() * az.sin(), el.sin(), el.cos() * az.cos())) * 0.25
                })
            })
            .collect();
        Scene { bvh: Bvh::new(b.mesh.triangles), materials: b.materials, sky }
    }

    /// Returns the approximate radiance from outdoors in direction `d`, for the lighting of diffuse surfaces.
    pub fn skylight(&self, d: V3) -> V3 {
        let (az, el) = (d.x.atan2(d.z), d.y.asin());
        let (u, v) = (az / std::f32::consts::PI + 0.5, el / std::f32::consts::PI + 0.5);
        let i = ((u * SKY_W as f32) as usize).min(SKY_W - 1);
        let j = ((v * SKY_H as f32) as usize).min(SKY_H - 1);
        self.sky[j * SKY_W + i]
    }

    pub fn finish(&self, triangle: u32) -> Finish {
        self.materials[self.bvh.triangles[triangle as usize].material as usize].finish
    }
}

/// Returns origin and direction of the ray through the pixel coordinates (x, y) of the reference frame.
pub fn camera_ray(x: f64, y: f64) -> (V3, V3) {
    let from = v3(0.30, 1.46, -1.15);
    let to = v3(-0.05, 1.16, 5.0);
    let ahead = (to - from).unit();
    let right = v3(ahead.z, 0.0, -ahead.x).unit();
    let down = right.cross(ahead);
    let down = if down.y > 0.0 { -down } else { down };
    let (u, v) = ((x - (WIDTH as f64 - 1.0) / 2.0) / FOCAL, (y - (HEIGHT as f64 - 1.0) / 2.0) / FOCAL);
    (from, (ahead + right * u as f32 + down * v as f32).unit())
}
