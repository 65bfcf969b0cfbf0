use super::*;
use crate::check::noise;
use crate::rasteriser::render::scene_tests::with_threads;

/// Owned [`Splats`].
#[derive(Clone)]
struct Scene {
    means2d: Vec<[f32; 2]>,
    conics: Vec<[f32; 3]>,
    depths: Vec<f32>,
    cutoffs: Vec<f32>,
}

impl Scene {
    fn lists(&self, grid: Grid) -> Result<TileLists, TooManyIntersections> {
        let Self { means2d, conics, depths, cutoffs } = self;
        tile_lists(&Splats { means2d, conics, depths, cutoffs }, grid)
    }
}

/// Ellipses of all shapes in and around an image of `size` pixels.
fn scene(count: usize, size: usize, seed: u64) -> Scene {
    let random = noise(7 * count, seed);
    let of = |kind: usize| random[kind * count..(kind + 1) * count].iter();
    let place = |&value: &f64| (0.5 * size as f64 * (1.0 + 1.3 * value)) as f32;
    let inverse_variance = |&value: &f64| (1.0 / (0.3 + (6.0 * value).exp())) as f32;
    let means2d = of(0).map(place).zip(of(1).map(place)).map(|(u, v)| [u, v]).collect();
    let shapes = of(2).map(inverse_variance).zip(of(3)).zip(of(4).map(inverse_variance));
    Scene {
        means2d,
        conics: shapes.map(|((a, &k), m)| [a, 3.0 * k as f32, m]).collect(),
        depths: of(5).map(|&value| 2.0 + value as f32).collect(),
        cutoffs: of(6).map(|&value| 2.77 + 2.77 * value as f32).collect(),
    }
}

/// σ at a pixel's centre in f64.
fn sigma(scene: &Scene, splat: usize, pixel: [usize; 2]) -> f64 {
    let [dx, dy] = [0, 1].map(|axis| f64::from(scene.means2d[splat][axis]) - (pixel[axis] as f64 + 0.5));
    let [a, k, m] = scene.conics[splat].map(f64::from);
    0.5 * (a * (dx + k * dy).powi(2) + m * dy * dy)
}

fn covers(scene: &Scene, splat: usize, pixel: [usize; 2]) -> bool {
    sigma(scene, splat, pixel) <= f64::from(scene.cutoffs[splat])
}

#[test]
fn every_covered_pixel_is_in_a_listed_tile() {
    let grid = Grid { width: 75, height: 53 };
    let scene = scene(3000, 75, 1);
    let lists = scene.lists(grid).unwrap();
    let holds = |lists: &TileLists, splat: usize, tile: usize| lists.tile(tile).contains(&lists.rank_of_splat[splat]);
    let missing = |lists: &TileLists| {
        let pixels = (0..grid.width).flat_map(|x| (0..grid.height).map(move |y| [x, y]));
        let tile_of = |pixel: [usize; 2]| pixel[1] / TILE * grid.columns() + pixel[0] / TILE;
        let covered = pixels.flat_map(|pixel| (0..3000).map(move |splat| (splat, pixel)));
        covered.filter(|&(splat, pixel)| covers(&scene, splat, pixel) && !holds(lists, splat, tile_of(pixel))).count()
    };
    assert_eq!(missing(&lists), 0);

    // Planted fault: cutoffs that are a little too small.
    let smaller = Scene { cutoffs: scene.cutoffs.iter().map(|cutoff| 0.98 * cutoff).collect(), ..scene.clone() };
    assert!(missing(&smaller.lists(grid).unwrap()) > 0);
}

#[test]
fn listed_tiles_are_met_by_the_ellipse() {
    let grid = Grid { width: 75, height: 53 };
    let scene = scene(1500, 75, 2);
    let lists = scene.lists(grid).unwrap();
    let mut needless = 0;
    for tile in 0..grid.tiles() {
        let ([left, top], [width, height]) = (grid.origin(tile), grid.extent(tile));
        for &rank in lists.tile(tile) {
            // The least σ over the rectangle of pixel centres, sampled at an eighth of a pixel.
            let splat = lists.order[rank as usize] as usize;
            let [u, v] = scene.means2d[splat].map(f64::from);
            let [a, k, m] = scene.conics[splat].map(f64::from);
            let least = (0..=8 * (height - 1)).map(|step| {
                let dy = v - (top as f64 + 0.5 + step as f64 / 8.0);
                let (low, high) = (left as f64 + 0.5, (left + width) as f64 - 0.5);
                let ridge = (u + k * dy).clamp(low, high);
                0.5 * (a * (u - ridge + k * dy).powi(2) + m * dy * dy)
            });
            let least = least.fold(f64::INFINITY, f64::min);
            needless += usize::from(least > f64::from(scene.cutoffs[splat]) * 1.01 + 0.01);
        }
    }
    assert!(needless * 200 <= lists.ranks.len(), "{needless} of {}", lists.ranks.len());
}

#[test]
fn lists_are_sorted_by_depth_then_index() {
    let grid = Grid { width: 64, height: 64 };
    let mut scene = scene(500, 64, 3);
    scene.depths.iter_mut().step_by(3).for_each(|depth| *depth = 2.5);
    let lists = scene.lists(grid).unwrap();
    for tile in 0..grid.tiles() {
        let splats: Vec<u32> = lists.tile(tile).iter().map(|&rank| lists.order[rank as usize]).collect();
        let key = |splat: u32| (scene.depths[splat as usize], splat);
        assert!(splats.windows(2).all(|pair| key(pair[0]) < key(pair[1])));
    }
}

#[test]
fn hits_and_entries_are_the_same_pairs() {
    let grid = Grid { width: 90, height: 40 };
    let scene = scene(800, 90, 4);
    let lists = scene.lists(grid).unwrap();
    assert_eq!(lists.ranks.len(), *lists.tile_starts.last().unwrap());
    assert_eq!(lists.ranks.len(), *lists.hit_starts.last().unwrap());
    let mut seen = vec![false; lists.ranks.len()];
    for splat in 0..800 {
        for &entry in lists.entries_of_splat(splat) {
            assert_eq!(lists.order[lists.ranks[entry as usize] as usize] as usize, splat);
            assert!(!std::mem::replace(&mut seen[entry as usize], true), "each entry once");
        }
    }
    assert!(seen.iter().all(|&seen| seen));
}

#[test]
fn poisoned_numbers_and_far_coordinates_are_harmless() {
    let grid = Grid { width: 33, height: 70 };
    let poisons = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e9, -1e9, 1e30, -1e30, f32::MIN_POSITIVE, 0.0, -0.0];
    let clean = scene(200, 70, 5);
    for (index, poison) in poisons.into_iter().cycle().take(60).enumerate() {
        let mut scene = clean.clone();
        match index / poisons.len() {
            0 | 1 => scene.means2d[7][index / poisons.len()] = poison,
            2..5 => scene.conics[7][index / poisons.len() - 2] = poison,
            _ => scene.cutoffs[7] = poison,
        }
        let lists = scene.lists(grid).unwrap();
        let columns = |tile: usize| lists.tile(tile).iter().filter(|&&rank| lists.order[rank as usize] != 7).count();
        let total: usize = (0..grid.tiles()).map(columns).sum();
        let expected = clean.lists(grid).unwrap();
        assert_eq!(total, expected.ranks.len() - expected.entries_of_splat(7).len(), "others are listed as before");
    }
}

#[test]
fn culled_splats_are_in_no_list() {
    let grid = Grid { width: 32, height: 32 };
    let mut scene = scene(100, 32, 6);
    scene.cutoffs.iter_mut().step_by(2).for_each(|cutoff| *cutoff = -1.0);
    let lists = scene.lists(grid).unwrap();
    assert!(lists.order.iter().all(|splat| splat % 2 == 1) && !lists.order.is_empty());
    scene.cutoffs.fill(-1.0);
    let lists = scene.lists(grid).unwrap();
    assert!(lists.order.is_empty() && lists.ranks.is_empty());
    assert_eq!(lists.tile_starts, [0; 5]);
}

#[test]
fn bounding_boxes_are_tight() {
    let scene = scene(200, 64, 7);
    for splat in 0..200 {
        let ellipse = Ellipse::new(scene.means2d[splat], scene.conics[splat], scene.cutoffs[splat]);
        let [a, k, m] = scene.conics[splat].map(f64::from);
        let radius = (2.0 * f64::from(scene.cutoffs[splat])).sqrt();
        // Points of the ellipse e = √2τ/√A·cos, dy = √2τ/√m·sin.
        let points = (0..3600).map(|step| {
            let angle = f64::from(step) * std::f64::consts::TAU / 3600.0;
            let dy = radius / m.sqrt() * angle.sin();
            [(radius / a.sqrt() * angle.cos() - k * dy).abs(), dy.abs()]
        });
        let extent = points.fold([0.0_f64; 2], |extent, point| [extent[0].max(point[0]), extent[1].max(point[1])]);
        for (found, expected) in ellipse.half_extents().map(f64::from).into_iter().zip(extent) {
            let is_tight = found >= expected * (1.0 - 1e-5) && found <= expected * 1.001 + 0.02 * expected.max(1.0);
            assert!(is_tight, "{found} {expected}");
        }
    }
}

#[test]
fn too_many_intersections_are_refused_without_listing_them() {
    // 2¹⁶ splats over the whole of 4096² pixels: 2³² pairs, more than 32 bits count.
    let count = 1 << 16;
    let full = Scene {
        means2d: vec![[2048.0, 2048.0]; count],
        conics: vec![[1e-12, 0.0, 1e-12]; count],
        depths: vec![1.0; count],
        cutoffs: vec![5.0; count],
    };
    let grid = Grid { width: 4096, height: 4096 };
    assert_eq!(full.lists(grid).unwrap_err(), TooManyIntersections { count: 1 << 32 });
}

#[test]
fn lists_do_not_depend_on_the_number_of_threads() {
    let grid = Grid { width: 200, height: 130 };
    let scene = scene(5000, 200, 8);
    let expected = with_threads(1, || scene.lists(grid).unwrap());
    for threads in [2, 3, 8] {
        assert!(with_threads(threads, || scene.lists(grid).unwrap()) == expected);
    }
}
