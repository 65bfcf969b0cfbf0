//! Moving bodies, and ray casting and shading at one instant.

use glam::DVec3;
use scene::RigidTransform;

use crate::placement::Placement;
use crate::ray::Ray;
use crate::shape::Shape;
use crate::texture::Texture;

/// Unit direction to the light: oblique from above, so that all sides of a body are lit differently.
const TO_LIGHT: DVec3 = DVec3::new(0.36, -0.48, 0.8);
/// Share of ambient light.
const AMBIENT: f64 = 0.35;
/// Sharpness of highlights (Blinn 1977).
const SHININESS: f64 = 40.0;

/// Radius of the background dome: 1.5 times the distance of the cameras.
pub(crate) const DOME_RADIUS: f64 = 6.0;

/// Placement of a body as a function of time in seconds.
pub(crate) type Motion = Box<dyn Fn(f64) -> Placement + Send + Sync>;

/// A textured surface in motion.
pub(crate) struct Body {
    /// Instance label: 0 for static bodies, otherwise the index of the name in [`World::class_names`] plus 1.
    pub(crate) label: u8,
    /// Surface in object coordinates.
    pub(crate) shape: Shape,
    /// Colours of material points.
    pub(crate) texture: Texture,
    /// Placement over time.
    pub(crate) motion: Motion,
}

/// A scene of moving bodies.
pub(crate) struct World {
    /// All bodies.
    pub(crate) bodies: Vec<Body>,
    /// Names of the moving instances, for the labels 1, 2, …
    pub(crate) class_names: Vec<String>,
    /// The point that all cameras look at.
    pub(crate) center_world: DVec3,
    /// Box around the bodies (min, max corner), set by hand: parts below the floor reach out of it, and the ball of `near-flyby`
    /// leaves it.
    pub(crate) bounds_world: [[f64; 3]; 2],
}

/// Options of shading.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shading {
    /// Weight of specular highlights.
    pub(crate) specular: f64,
    /// Whether bodies cast shadows.
    pub(crate) shadows: bool,
}

/// The world at one instant.
pub(crate) struct Instant<'a> {
    time_secs: f64,
    bodies: Vec<Posed<'a>>,
}

/// A body in its pose at one instant.
struct Posed<'a> {
    body: &'a Body,
    placement: Placement,
    object_from_world: RigidTransform,
    bounding_center: DVec3,
    bounding_radius: f64,
}

/// The first hit of a ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    /// Index in [`World::bodies`].
    pub(crate) body: usize,
    /// Distance along the ray, in units of its direction.
    pub(crate) distance: f64,
    /// The material point, in object coordinates at the time of the hit.
    pub(crate) material: DVec3,
    /// Unit normal, facing the origin of the ray.
    pub(crate) normal_world: DVec3,
}

impl Body {
    /// A static body with label 0.
    pub(crate) fn resting(shape: Shape, texture: Texture, position: DVec3) -> Self {
        Self { label: 0, shape, texture, motion: Box::new(move |_| Placement::resting(position)) }
    }
}

impl World {
    /// The world at a time.
    pub(crate) fn at(&self, time_secs: f64) -> Instant<'_> {
        let posed = |body| Posed::new(body, time_secs);
        Instant { time_secs, bodies: self.bodies.iter().map(posed).collect() }
    }
}

impl Instant<'_> {
    /// The first hit of a ray, if any.
    pub(crate) fn hit(&self, ray: &Ray) -> Option<Hit> {
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

    /// World position of a material point at this instant.
    pub(crate) fn position_world(&self, body: usize, material: DVec3) -> DVec3 {
        let posed = &self.bodies[body];
        posed.placement.world_from_object.apply(posed.body.shape.position(material, self.time_secs))
    }

    /// World velocity of a material point at this instant: the motion of the body's frame plus the motion within it.
    pub(crate) fn velocity_world(&self, body: usize, material: DVec3) -> DVec3 {
        let posed = &self.bodies[body];
        let own = posed.body.shape.velocity(material, self.time_secs);
        let frame = posed.placement.velocity(self.position_world(body, material));
        frame + posed.placement.world_from_object.rotation * own
    }

    /// The instance label of the body that was hit.
    pub(crate) fn label(&self, hit: &Hit) -> u8 {
        self.bodies[hit.body].body.label
    }

    /// The sRGB-encoded colour of a hit: Lambertian reflection with ambient light, and optionally a highlight and a
    /// shadow.
    pub(crate) fn color(&self, ray: &Ray, hit: &Hit, shading: Shading) -> DVec3 {
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

    /// Whether a hit body blocks the light; the background dome does not.
    fn casts_shadow(&self, hit: &Hit) -> bool {
        !matches!(self.bodies[hit.body].body.shape, Shape::Sphere { radius } if radius >= DOME_RADIUS)
    }
}

impl<'a> Posed<'a> {
    /// Evaluates the motion of a body.
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

    /// Whether the line of the ray meets the bounding sphere.
    fn may_hit(&self, ray: &Ray) -> bool {
        let offset = self.bounding_center - ray.origin;
        let along = offset.dot(ray.direction) / ray.direction.length_squared();
        (offset - along * ray.direction).length_squared() <= self.bounding_radius.powi(2)
    }
}
