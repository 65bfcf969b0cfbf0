//! Pixels of row-major images: centres, the pixel that contains a position, neighbours, and differences of colours.

use glam::DVec2;

/// Centres of all pixels of an image, row by row.
pub fn centers(width: u32, height: u32) -> impl Iterator<Item = DVec2> {
    let center = |x: u32, y: u32| DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
    (0..height).flat_map(move |y| (0..width).map(move |x| center(x, y)))
}

/// Centre of the pixel with a row-major index.
pub fn center(index: usize, width: u32) -> DVec2 {
    let width = width as usize;
    DVec2::new((index % width) as f64 + 0.5, (index / width) as f64 + 0.5)
}

/// Row-major index of the pixel that contains a position; `None` outside the image and for NaN.
pub fn index_at(position: DVec2, width: u32, height: u32) -> Option<usize> {
    let inside = position.cmpge(DVec2::ZERO).all() && position.x < f64::from(width) && position.y < f64::from(height);
    inside.then(|| position.y as usize * width as usize + position.x as usize)
}

/// Row-major indices of the up to eight pixels around the pixel `index`.
pub fn neighbors(index: usize, width: u32, height: u32) -> impl Iterator<Item = usize> {
    let (width, height) = (width as usize, height as usize);
    let (x, y) = (index % width, index / width);
    let columns = x.saturating_sub(1)..(x + 2).min(width);
    let rows = y.saturating_sub(1)..(y + 2).min(height);
    let all = rows.flat_map(move |row| columns.clone().map(move |column| row * width + column));
    all.filter(move |other| *other != index)
}

/// The mean absolute difference of two colours over their channels, in grey levels.
pub fn difference(a: [u8; 3], b: [u8; 3]) -> f64 {
    a.into_iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(b))).sum::<f64>() / 3.0
}

/// The mean of [`difference`] over pairs of colours; `None` without one.
pub fn mean_difference(pairs: impl Iterator<Item = ([u8; 3], [u8; 3])>) -> Option<f64> {
    let (sum, count) = pairs.fold((0.0, 0_usize), |(sum, count), (a, b)| (sum + difference(a, b), count + 1));
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centers_and_indices_are_inverse() {
        for (index, position) in centers(3, 2).enumerate() {
            assert_eq!(center(index, 3), position);
            assert_eq!(index_at(position, 3, 2), Some(index));
        }
        for outside in [DVec2::new(-0.1, 0.5), DVec2::new(3.0, 0.5), DVec2::new(0.5, 2.0), DVec2::NAN] {
            assert_eq!(index_at(outside, 3, 2), None, "{outside}");
        }
    }

    #[test]
    fn differences_are_means_over_channels_and_pairs() {
        assert_eq!(difference([0, 10, 255], [3, 4, 255]), 3.0);
        let pairs = [([0; 3], [9; 3]), ([5; 3], [5, 5, 8])];
        assert_eq!((mean_difference(pairs.into_iter()), mean_difference([].into_iter())), (Some(5.0), None));
    }

    #[test]
    fn neighbors_stay_inside_the_image() {
        assert_eq!(neighbors(0, 3, 2).collect::<Vec<_>>(), [1, 3, 4]);
        assert_eq!(neighbors(4, 3, 3).collect::<Vec<_>>(), [0, 1, 2, 3, 5, 6, 7, 8]);
    }
}
