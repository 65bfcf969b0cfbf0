//! Binary images and their morphology.

use scene::LabelMap;

/// What a mask's pixels are in files, where they are inside.
const INSIDE: u8 = 255;

/// A binary image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// [H, W].
    pub inside: Vec<bool>,
}

impl From<&LabelMap> for Mask {
    fn from(map: &LabelMap) -> Self {
        Self { width: map.width, height: map.height, inside: map.labels.iter().map(|label| *label != 0).collect() }
    }
}

impl Mask {
    /// A mask without any pixel.
    pub fn empty(width: u32, height: u32) -> Self {
        Self { width, height, inside: vec![false; width as usize * height as usize] }
    }

    /// The mask as it is written: 255 inside, 0 outside.
    pub fn to_labels(&self) -> LabelMap {
        let labels = self.inside.iter().map(|inside| if *inside { INSIDE } else { 0 }).collect();
        LabelMap { width: self.width, height: self.height, labels }
    }

    /// Pixels inside.
    pub fn count(&self) -> usize {
        self.inside.iter().filter(|inside| **inside).count()
    }

    /// Inside of either.
    pub fn or(&self, other: &Self) -> Self {
        self.combined(other, |a, b| a || b)
    }

    /// Inside of this one and not of the other.
    pub fn without(&self, other: &Self) -> Self {
        self.combined(other, |a, b| a && !b)
    }

    /// Everything within a square of `2 · radius_px + 1` pixels around a pixel inside.
    pub fn dilated(&self, radius_px: u32) -> Self {
        let (width, height, radius) = (self.width as usize, self.height as usize, radius_px as usize);
        let rows = spread(&self.inside, [height, width], [width, 1], radius);
        let inside = spread(&rows, [width, height], [1, width], radius);
        Self { inside, ..*self }
    }

    /// The pixels whose square lies inside; what lies beyond the border counts as inside.
    pub fn eroded(&self, radius_px: u32) -> Self {
        self.complement().dilated(radius_px).complement()
    }

    /// Without gaps that a square of `2 · radius_px + 1` pixels does not fit in; beyond the border nothing is inside.
    pub fn closed(&self, radius_px: u32) -> Self {
        // With room for the dilation, which would otherwise stick to the border.
        self.padded(radius_px).dilated(radius_px).eroded(radius_px).cropped(radius_px)
    }

    /// With `margin_px` pixels outside on every side.
    fn padded(&self, margin_px: u32) -> Self {
        let mut larger = Self::empty(self.width + 2 * margin_px, self.height + 2 * margin_px);
        for (row, values) in self.inside.chunks_exact(self.width as usize).enumerate() {
            let start = (row + margin_px as usize) * larger.width as usize + margin_px as usize;
            larger.inside[start..][..values.len()].copy_from_slice(values);
        }
        larger
    }

    /// Without `margin_px` pixels on every side.
    fn cropped(&self, margin_px: u32) -> Self {
        let (width, height, margin) = (self.width - 2 * margin_px, self.height - 2 * margin_px, margin_px as usize);
        let rows = self.inside.chunks_exact(self.width as usize).skip(margin).take(height as usize);
        let inside = rows.flat_map(|row| &row[margin..margin + width as usize]).copied().collect();
        Self { width, height, inside }
    }

    /// Without connected parts and without holes of fewer than `min_area_px` pixels (area opening and closing, Vincent
    /// 1993), which thin parts of large things survive.
    pub fn without_specks(&self, min_area_px: usize) -> Self {
        let without_small = |mask: &Self| {
            let mut kept = mask.clone();
            for part in mask.parts().iter().filter(|part| part.len() < min_area_px) {
                part.iter().for_each(|at| kept.inside[*at] = false);
            }
            kept
        };
        without_small(&without_small(self).complement()).complement()
    }

    /// The pixels of every part that is connected by sides and corners.
    fn parts(&self) -> Vec<Vec<usize>> {
        let mut seen = vec![false; self.inside.len()];
        let mut parts = Vec::new();
        for start in 0..self.inside.len() {
            if seen[start] || !self.inside[start] {
                continue;
            }
            let (mut part, mut next) = (vec![start], 0);
            seen[start] = true;
            while let Some(at) = part.get(next).copied() {
                next += 1;
                for neighbor in neighbors(at, self.width as usize, self.height as usize) {
                    if self.inside[neighbor] && !seen[neighbor] {
                        seen[neighbor] = true;
                        part.push(neighbor);
                    }
                }
            }
            parts.push(part);
        }
        parts
    }

    fn complement(&self) -> Self {
        Self { inside: self.inside.iter().map(|inside| !inside).collect(), ..*self }
    }

    fn combined(&self, other: &Self, combine: impl Fn(bool, bool) -> bool) -> Self {
        assert_eq!((self.width, self.height), (other.width, other.height), "masks of one view have one size");
        let pairs = self.inside.iter().zip(&other.inside);
        Self { inside: pairs.map(|(a, b)| combine(*a, *b)).collect(), ..*self }
    }
}

/// Indices of the up to eight pixels around the pixel `at`.
pub fn neighbors(at: usize, width: usize, height: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (at % width, at / width);
    let columns = x.saturating_sub(1)..(x + 2).min(width);
    let rows = y.saturating_sub(1)..(y + 2).min(height);
    rows.flat_map(move |row| columns.clone().map(move |column| row * width + column)).filter(move |other| *other != at)
}

/// Each pixel of `lines` lines of `length` pixels is set if one within `radius` on its line is; `strides` lead to the
/// next line and to the next pixel.
fn spread(inside: &[bool], [lines, length]: [usize; 2], strides: [usize; 2], radius: usize) -> Vec<bool> {
    let mut result = vec![false; inside.len()];
    for line in 0..lines {
        let at = |place: usize| line * strides[0] + place * strides[1];
        // How many places ago, and in how many places, the nearest pixel inside lies.
        let mut since = usize::MAX;
        for place in 0..length {
            since = if inside[at(place)] { 0 } else { since.saturating_add(1) };
            result[at(place)] |= since <= radius;
        }
        let mut until = usize::MAX;
        for place in (0..length).rev() {
            until = if inside[at(place)] { 0 } else { until.saturating_add(1) };
            result[at(place)] |= until <= radius;
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(rows: &[&str]) -> Mask {
        let inside = rows.iter().flat_map(|row| row.bytes().map(|symbol| symbol == b'#')).collect();
        Mask { width: rows[0].len() as u32, height: rows.len() as u32, inside }
    }

    #[test]
    fn dilation_grows_squares_and_erosion_takes_them_back() {
        let dot = mask(&[".......", ".......", "...#...", ".......", "......."]);
        assert_eq!(dot.dilated(1), mask(&[".......", "..###..", "..###..", "..###..", "......."]));
        assert_eq!(dot.dilated(1).eroded(1), dot);
        assert_eq!(dot.dilated(0), dot);
        assert_eq!(dot.dilated(9).count(), 35);
        let corner = mask(&["##.", "##.", "..."]);
        assert_eq!(corner.eroded(1), mask(&["#..", "...", "..."]));
    }

    #[test]
    fn closing_bridges_gaps() {
        let gap = mask(&["......", "##.##.", "##.##.", "......"]);
        assert_eq!(gap.closed(1), mask(&["......", "#####.", "#####.", "......"]));
    }

    #[test]
    fn specks_go_and_thin_lines_stay() {
        let noisy = mask(&["#......", ".......", "..#####", "......#", "......#"]);
        assert_eq!(noisy.without_specks(4), mask(&[".......", ".......", "..#####", "......#", "......#"]));
        let holed = mask(&["#####", "##.##", "#####"]);
        assert_eq!(holed.without_specks(2), mask(&["#####", "#####", "#####"]));
        assert_eq!(holed.without_specks(0), holed);
    }
}
