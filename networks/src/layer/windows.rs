//! Which windows of the images of a batch are the same.
//!
//! Windows that see the same give the same numbers, so a layer computes each distinct one once. Grids of
//! cells repeat themselves: of the windows of a minibatch a tenth or less is distinct. An image is a row
//! of numbers that say what its pixels are: classes of cells, or which distinct window of the layer
//! before; so windows are compared by a few numbers each, whatever they see in the end.

use hashbrown::HashTable;
use rustc_hash::FxBuildHasher;
use std::hash::BuildHasher;

/// Numbers that are copied at a time.
const CHUNK: usize = 8;

/// Where the windows of an image lie.
#[derive(Clone, Debug)]
pub(crate) struct Windows {
    /// Pixels of an image, all frames together.
    pixels: usize,
    /// Where the pixels of a window lie, from its first.
    window: Vec<usize>,
    /// Where the windows begin.
    starts: Vec<usize>,
    /// How many there are, one below another and beside another.
    pub(crate) size: [usize; 2],
}

/// The distinct windows of a batch of images, in order of their first appearance.
#[derive(Clone, Debug, Default)]
pub(crate) struct Distinct {
    /// The pixels of one after another.
    pub(crate) pixels: Vec<u32>,
    /// Which of them every window of every image is.
    pub(crate) which: Vec<u32>,
    table: HashTable<u32>,
}

impl Windows {
    /// Square windows of so many pixels a side, `step` apart, over `frames` images of `[height, width]`
    /// that lie behind each other. What does not fill a window is left out.
    pub(crate) fn square(
        frames: usize,
        [height, width]: [usize; 2],
        side: usize,
        step: usize,
    ) -> Windows {
        let grid = |rows: usize, columns: usize, step: usize| {
            (0..rows).flat_map(move |y| (0..columns).map(move |x| (y * width + x) * step))
        };
        let size = [height, width].map(|pixels| (pixels - side) / step + 1);
        let frame = |index: usize| grid(side, side, 1).map(move |at| index * height * width + at);
        Windows {
            pixels: frames * height * width,
            window: (0..frames).flat_map(frame).collect(),
            starts: grid(size[0], size[1], step).collect(),
            size,
        }
    }

    /// One window that sees the whole image.
    pub(crate) fn whole([height, width]: [usize; 2]) -> Windows {
        let pixels = height * width;
        Windows { pixels, window: (0..pixels).collect(), starts: vec![0], size: [1, 1] }
    }

    /// Pixels of a window.
    pub(crate) fn len(&self) -> usize {
        self.window.len()
    }
}

impl Distinct {
    /// Finds the distinct windows of images.
    pub(crate) fn find<P: Copy + Into<u32>>(&mut self, windows: &Windows, images: &[P]) {
        self.pixels.clear();
        self.which.clear();
        self.table.clear();
        let mut window = vec![0; windows.len()];
        for image in images.chunks_exact(windows.pixels) {
            let above = self.which.len().saturating_sub(windows.starts.len());
            for (position, &start) in windows.starts.iter().enumerate() {
                let image = &image[start..];
                for (pixel, &offset) in window.iter_mut().zip(&windows.window) {
                    *pixel = image[offset].into();
                }
                // Most often it is what the image before had in the same place.
                let guess = self.which.get(above + position).copied();
                let which = guess.filter(|&guess| self.is(guess, &window));
                let which = which.unwrap_or_else(|| self.number_of(&window));
                self.which.push(which);
            }
        }
    }

    fn is(&self, number: u32, window: &[u32]) -> bool {
        // Windows are short: a call that compares bytes costs more than this does.
        let known = &self.pixels[number as usize * window.len()..][..window.len()];
        known.iter().zip(window).fold(0, |differ, (one, other)| differ | (one ^ other)) == 0
    }

    /// The number of a window, which is a new one if it has not been seen.
    fn number_of(&mut self, window: &[u32]) -> u32 {
        let hash = hash(window);
        if let Some(&known) = self.table.find(hash, |&known| self.is(known, window)) {
            return known;
        }
        let number = (self.pixels.len() / window.len()) as u32;
        self.pixels.extend_from_slice(window);
        let pixels = &self.pixels;
        let hash_of =
            |known: &u32| self::hash(&pixels[*known as usize * window.len()..][..window.len()]);
        self.table.insert_unique(hash, number, hash_of);
        number
    }

    /// Writes what each distinct window sees to `input`, where `outputs` has the `channels` numbers of
    /// every pixel there is.
    pub(crate) fn gather(&self, outputs: &[f32], channels: usize, input: &mut Vec<f32>) {
        input.resize(self.pixels.len() * channels, 0.0);
        for (&pixel, input) in self.pixels.iter().zip(input.chunks_exact_mut(channels)) {
            let numbers = outputs[pixel as usize * channels..][..channels].as_chunks::<CHUNK>();
            let (chunks, rest) = input.as_chunks_mut::<CHUNK>();
            chunks.iter_mut().zip(numbers.0).for_each(|(chunk, numbers)| *chunk = *numbers);
            rest.copy_from_slice(numbers.1);
        }
    }

    /// Adds the numbers of every window of every image to those of the distinct one that it is.
    pub(crate) fn sum(&self, numbers: &[f32], channels: usize, sums: &mut [f32]) {
        add_at(&self.which, numbers, channels, sums);
    }

    /// Adds the gradient of what each distinct window sees to that of the pixels.
    pub(crate) fn spread(&self, input: &[f32], channels: usize, outputs: &mut [f32]) {
        add_at(&self.pixels, input, channels, outputs);
    }
}

/// Adds rows of numbers to the rows of sums that they belong to.
fn add_at(places: &[u32], numbers: &[f32], width: usize, sums: &mut [f32]) {
    for (&place, numbers) in places.iter().zip(numbers.chunks_exact(width)) {
        let sums = &mut sums[place as usize * width..][..width];
        sums.iter_mut().zip(numbers).for_each(|(sum, number)| *sum += number);
    }
}

fn hash(pixels: &[u32]) -> u64 {
    FxBuildHasher.hash_one(pixels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_windows_are_one() {
        // Two images of 3 x 3: the windows of 2 x 2 of the second are all of the same.
        let images = [0, 1, 0, 1, 0, 1, 0, 1, 0, 2, 2, 2, 2, 2, 2, 2, 2, 2_u8];
        let windows = Windows::square(1, [3, 3], 2, 1);
        let mut distinct = Distinct::default();
        for _ in 0..2 {
            distinct.find(&windows, &images);
            assert_eq!(distinct.pixels, [0, 1, 1, 0, 1, 0, 0, 1, 2, 2, 2, 2]);
            assert_eq!(distinct.which, [0, 1, 1, 0, 2, 2, 2, 2]);
        }
        let whole = Windows::whole([2, 2]);
        let which = distinct.which.clone();
        distinct.find(&whole, &which);
        assert_eq!((&distinct.which[..], distinct.pixels.len()), (&[0, 1][..], 8));
    }

    #[test]
    fn windows_see_all_frames() {
        let windows = Windows::square(2, [3, 2], 2, 1);
        assert_eq!((windows.size, windows.len()), ([2, 1], 8));
        let mut distinct = Distinct::default();
        distinct.find(&windows, &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11_u8]);
        assert_eq!(distinct.pixels, [0, 1, 2, 3, 6, 7, 8, 9, 2, 3, 4, 5, 8, 9, 10, 11]);
    }

    #[test]
    fn what_is_gathered_is_spread_to_where_it_came_from() {
        let windows = Windows::square(1, [1, 3], 1, 1);
        let mut distinct = Distinct::default();
        distinct.find(&windows, &[1, 0, 1_u8]);
        let mut input = Vec::new();
        distinct.gather(&[1.0, 2.0, 3.0, 4.0], 2, &mut input);
        assert_eq!(input, [3.0, 4.0, 1.0, 2.0]);
        let mut gradient = [0.5; 4];
        distinct.spread(&input, 2, &mut gradient);
        assert_eq!(gradient, [1.5, 2.5, 3.5, 4.5]);
    }
}
