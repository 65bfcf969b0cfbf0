//! Binary masks and their morphology.

use crate::{LabelMap, pixels};

/// Grey level of set pixels in files.
const INSIDE: u8 = 255;

/// A binary image of set pixels, e.g. of the moving pixels of a view.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// [H, W]: whether a pixel is set.
    pub inside: Vec<bool>,
}

/// Every label but 0 is set.
impl From<&LabelMap> for Mask {
    fn from(map: &LabelMap) -> Self {
        Self { width: map.width, height: map.height, inside: map.labels.iter().map(|label| *label != 0).collect() }
    }
}

impl Mask {
    /// A mask of the given size with no pixel set.
    pub fn empty(width: u32, height: u32) -> Self {
        Self { width, height, inside: vec![false; width as usize * height as usize] }
    }

    /// The mask as stored in files: 255 where set, 0 elsewhere.
    pub fn to_labels(&self) -> LabelMap {
        let labels = self.inside.iter().map(|inside| if *inside { INSIDE } else { 0 }).collect();
        LabelMap { width: self.width, height: self.height, labels }
    }

    /// Number of set pixels.
    pub fn count(&self) -> usize {
        self.inside.iter().filter(|inside| **inside).count()
    }

    /// Union with a mask of the same size.
    pub fn or(&self, other: &Self) -> Self {
        self.combined(other, |a, b| a || b)
    }

    /// Difference: the pixels that are set here and not in `other`, a mask of the same size.
    pub fn without(&self, other: &Self) -> Self {
        self.combined(other, |a, b| a && !b)
    }

    /// Dilation by a square with a side of `2 · radius_px + 1` pixels.
    pub fn dilated(&self, radius_px: u32) -> Self {
        let (width, height, radius) = (self.width as usize, self.height as usize, radius_px as usize);
        let rows = spread(&self.inside, [height, width], [width, 1], radius);
        let inside = spread(&rows, [width, height], [1, width], radius);
        Self { inside, ..*self }
    }

    /// Erosion by a square with a side of `2 · radius_px + 1` pixels; pixels outside the image count as set.
    fn eroded(&self, radius_px: u32) -> Self {
        self.complement().dilated(radius_px).complement()
    }

    /// Closing by a square with a side of `2 · radius_px + 1` pixels; pixels outside the image count as not set.
    pub fn closed(&self, radius_px: u32) -> Self {
        // The padding keeps the dilation from sticking to the image border.
        self.padded(radius_px).dilated(radius_px).eroded(radius_px).cropped(radius_px)
    }

    /// Adds `margin_px` pixels, not set, on every side.
    fn padded(&self, margin_px: u32) -> Self {
        let mut larger = Self::empty(self.width + 2 * margin_px, self.height + 2 * margin_px);
        for (row, values) in self.inside.chunks_exact(self.width as usize).enumerate() {
            let start = (row + margin_px as usize) * larger.width as usize + margin_px as usize;
            larger.inside[start..][..values.len()].copy_from_slice(values);
        }
        larger
    }

    /// Removes `margin_px` pixels on every side.
    fn cropped(&self, margin_px: u32) -> Self {
        let (width, height, margin) = (self.width - 2 * margin_px, self.height - 2 * margin_px, margin_px as usize);
        let rows = self.inside.chunks_exact(self.width as usize).skip(margin).take(height as usize);
        let inside = rows.flat_map(|row| &row[margin..margin + width as usize]).copied().collect();
        Self { width, height, inside }
    }

    /// Removes connected components and fills holes of fewer than `min_area_px` pixels: area opening and closing
    /// (Vincent 1993), which keep thin parts of large components.
    pub fn without_specks(&self, min_area_px: usize) -> Self {
        let without_small = |mask: &Self| {
            let mut kept = mask.clone();
            for component in mask.components().iter().filter(|component| component.len() < min_area_px) {
                component.iter().for_each(|at| kept.inside[*at] = false);
            }
            kept
        };
        without_small(&without_small(self).complement()).complement()
    }

    /// Pixel indices (row by row, of the whole image) of every 8-connected component.
    pub fn components(&self) -> Vec<Vec<usize>> {
        let mut seen = vec![false; self.inside.len()];
        let mut components = Vec::new();
        for start in 0..self.inside.len() {
            if seen[start] || !self.inside[start] {
                continue;
            }
            let (mut component, mut next) = (vec![start], 0);
            seen[start] = true;
            while let Some(at) = component.get(next).copied() {
                next += 1;
                for neighbor in pixels::neighbors(at, self.width, self.height) {
                    if self.inside[neighbor] && !seen[neighbor] {
                        seen[neighbor] = true;
                        component.push(neighbor);
                    }
                }
            }
            components.push(component);
        }
        components
    }

    /// Inverts every pixel.
    fn complement(&self) -> Self {
        Self { inside: self.inside.iter().map(|inside| !inside).collect(), ..*self }
    }

    /// Combines two masks of one size pixel by pixel.
    fn combined(&self, other: &Self, combine: impl Fn(bool, bool) -> bool) -> Self {
        assert_eq!((self.width, self.height), (other.width, other.height), "masks of one view have one size");
        let pairs = self.inside.iter().zip(&other.inside);
        Self { inside: pairs.map(|(a, b)| combine(*a, *b)).collect(), ..*self }
    }
}

/// One-dimensional dilation: sets every pixel that has a set pixel within `radius` on its line. The image has `lines`
/// lines of `length` pixels; `strides` are the index steps to the next line and to the next pixel.
fn spread(inside: &[bool], [lines, length]: [usize; 2], strides: [usize; 2], radius: usize) -> Vec<bool> {
    let mut result = vec![false; inside.len()];
    for line in 0..lines {
        let at = |place: usize| line * strides[0] + place * strides[1];
        // Distance to the nearest set pixel before and after.
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
    fn erosion_reverts_the_dilation_of_a_dot() {
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
    fn specks_are_removed_and_thin_lines_stay() {
        let noisy = mask(&["#......", ".......", "..#####", "......#", "......#"]);
        assert_eq!(noisy.without_specks(4), mask(&[".......", ".......", "..#####", "......#", "......#"]));
        let holed = mask(&["#####", "##.##", "#####"]);
        assert_eq!(holed.without_specks(2), mask(&["#####", "#####", "#####"]));
        assert_eq!(holed.without_specks(0), holed);
    }
}
