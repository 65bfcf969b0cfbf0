//! Bodies in motion, and what a ray meets at one instant.

use glam::DVec3;
use scene::RigidTransform;

use crate::placement::Placement;
use crate::shape::{Ray, Shape};
use crate::texture::Texture;

/// Direction to the light: from above, a little to one side, so that all sides of a body differ.
const TO_LIGHT: DVec3 = DVec3::new(0.36, -0.48, 0.8);
/// Share of the light that comes from everywhere.
const AMBIENT: f64 = 0.35;
/// Sharpness of highlights (Blinn 1977).
const SHININESS: f64 = 40.0;

/// Placement of a body as a function of seconds.
pub type Motion = Box<dyn Fn(f64) -> Placement + Send + Sync>;

/// A textured surface in motion.
pub struct Body {
    /// 0 for what never moves, else the position of its name in [`World::class_names`] plus 1.
    pub label: u8,
    /// In object coordinates.
    pub shape: Shape,
    /// Of material points.
    pub texture: Texture,
    /// World from object.
    pub motion: Motion,
}

/// A scene.
pub struct World {
    /// Everything that can be seen.
    pub bodies: Vec<Body>,
    /// Names of the moving instances.
    pub class_names: Vec<String>,
    /// What cameras look at.
    pub center_world: DVec3,
    /// Min and max corner of what the bodies reach.
    pub bounds_world: [[f64; 3]; 2],
}

/// How surfaces answer the light.
#[derive(Clone, Copy, Debug)]
pub struct Shading {
    /// Weight of highlights.
    pub specular: f64,
    /// Whether bodies darken each other.
    pub shadows: bool,
}

/// The world at one time.
pub struct Instant<'a> {
    time_secs: f64,
    bodies: Vec<Posed<'a>>,
}

struct Posed<'a> {
    body: &'a Body,
    placement: Placement,
    object_from_world: RigidTransform,
    bounding_center: DVec3,
    bounding_radius: f64,
}

/// What a ray meets first.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// Position in [`World::bodies`].
    pub body: usize,
    /// Along the ray, in units of its direction.
    pub distance: f64,
    /// The material point: object coordinates at the time of the hit.
    pub material: DVec3,
    /// Unit, towards where the ray comes from.
    pub normal_world: DVec3,
}

impl Body {
    /// A body that never moves.
    pub fn resting(shape: Shape, texture: Texture, position: DVec3) -> Self {
        Self { label: 0, shape, texture, motion: Box::new(move |_| Placement::resting(position)) }
    }
}

impl World {
    /// All bodies where they are at `time_secs`.
    pub fn at(&self, time_secs: f64) -> Instant<'_> {
        let posed = |body| Posed::new(body, time_secs);
        Instant { time_secs, bodies: self.bodies.iter().map(posed).collect() }
    }
}

impl Instant<'_> {
    /// The nearest surface on the ray.
    pub fn hit(&self, ray: &Ray) -> Option<Hit> {
        let mut nearest: Option<Hit> = None;
        for (index, posed) in self.bodies.iter().enumerate() {
            if !posed.may_hit(ray) {
                continue;
            }
            let rotation = posed.object_from_world.rotation;
            let ray = Ray { origin: posed.object_from_world.apply(ray.origin), direction: rotation * ray.direction };
            let Some((distance, normal)) = posed.body.shape.hit(&ray, self.time_secs) else { continue };
            if nearest.is_none_or(|nearest| distance < nearest.distance) {
                let normal = if normal.dot(ray.direction) > 0.0 { -normal } else { normal };
                let normal_world = posed.placement.world_from_object.rotation * normal;
                nearest = Some(Hit { body: index, distance, material: ray.at(distance), normal_world });
            }
        }
        nearest
    }

    /// Where a material point is now.
    pub fn position_world(&self, body: usize, material: DVec3) -> DVec3 {
        let posed = &self.bodies[body];
        posed.placement.world_from_object.apply(posed.body.shape.position(material, self.time_secs))
    }

    /// How fast a material point moves now: the motion of its frame plus its own motion in it.
    pub fn velocity_world(&self, body: usize, material: DVec3) -> DVec3 {
        let posed = &self.bodies[body];
        let own = posed.body.shape.velocity(material, self.time_secs);
        let frame = posed.placement.velocity(self.position_world(body, material));
        frame + posed.placement.world_from_object.rotation * own
    }

    /// The instance label of a body.
    pub fn label(&self, hit: &Hit) -> u8 {
        self.bodies[hit.body].body.label
    }

    /// The sRGB-encoded colour of a hit: Lambert with ambient light, plus a highlight and a shadow where wanted.
    pub fn color(&self, ray: &Ray, hit: &Hit, shading: Shading) -> DVec3 {
        let albedo = self.bodies[hit.body].body.texture.color(hit.material);
        let shaded = || {
            let origin = ray.at(hit.distance) + 1e-6 * hit.normal_world;
            self.hit(&Ray { origin, direction: TO_LIGHT }).is_some_and(|other| self.casts_shadow(&other))
        };
        let facing = hit.normal_world.dot(TO_LIGHT).max(0.0);
        let direct = if shading.shadows && facing > 0.0 && shaded() { 0.0 } else { facing };
        let diffuse = albedo * (AMBIENT + (1.0 - AMBIENT) * direct);
        if shading.specular == 0.0 || direct == 0.0 {
            return diffuse;
        }
        let halfway = (TO_LIGHT - ray.direction.normalize()).normalize();
        diffuse + DVec3::splat(shading.specular * hit.normal_world.dot(halfway).max(0.0).powf(SHININESS))
    }

    /// A dome around the light's way is no obstacle.
    fn casts_shadow(&self, hit: &Hit) -> bool {
        !matches!(self.bodies[hit.body].body.shape, Shape::Sphere { radius } if radius >= crate::scenes::DOME_RADIUS)
    }
}

impl<'a> Posed<'a> {
    fn new(body: &'a Body, time_secs: f64) -> Self {
        let placement = (body.motion)(time_secs);
        let (center, bounding_radius) = body.shape.bounding_sphere();
        Self {
            body,
            placement,
            object_from_world: placement.world_from_object.inverse(),
            bounding_center: placement.world_from_object.apply(center),
            bounding_radius,
        }
    }

    /// Whether the ray comes near enough to be worth an exact test.
    fn may_hit(&self, ray: &Ray) -> bool {
        let offset = self.bounding_center - ray.origin;
        let along = offset.dot(ray.direction) / ray.direction.length_squared();
        (offset - along * ray.direction).length_squared() <= self.bounding_radius.powi(2)
    }
}
