//! Finds equal windows in the images of a batch.
//!
//! Windows with equal content give equal outputs, so a layer computes each distinct window only once. Grids of
//! cells repeat themselves, so few of the windows of a minibatch are distinct. Windows are compared by a few packed
//! words each, however large their receptive field is. Once the windows of some images are known, a
//! subset of these images needs no new comparison.

use hashbrown::HashTable;
use rustc_hash::FxHasher;
use std::hash::Hasher;

use super::windows::{Packing, Windows};

/// Numbers copied at a time.
const CHUNK: usize = 8;

/// The distinct windows of a batch of images, in order of their first appearance.
#[derive(Clone, Debug, Default)]
pub(crate) struct Distinct {
    /// Pixels of the distinct windows, one window after another.
    pub(crate) pixels: Vec<u32>,
    /// Number of the distinct window for every window of every image.
    pub(crate) which: Vec<u32>,
    /// Packed pixels of the distinct windows, one window after another.
    packed: Vec<u64>,
    table: HashTable<u32>,
    /// Packed windows of the current image and, in `before`, of the previous image.
    image: Vec<u64>,
    before: Vec<u64>,
    numbering: Numbering,
}

/// Numbering of the windows of chosen images.
#[derive(Clone, Debug, Default)]
struct Numbering {
    /// New number of each window, or [`Numbering::NONE`] if the window was not chosen.
    new: Vec<u32>,
    /// Window for each new number.
    chosen: Vec<u32>,
}

impl Numbering {
    const NONE: u32 = u32::MAX;

    /// Clears all numbers; there are `windows` windows to choose from.
    fn begin(&mut self, windows: usize) {
        for window in self.chosen.drain(..) {
            self.new[window as usize] = Numbering::NONE;
        }
        self.new.resize(windows, Numbering::NONE);
    }

    /// Returns the new number of a window, assigning one if it has none.
    fn number(&mut self, window: u32) -> u32 {
        let new = &mut self.new[window as usize];
        if *new == Numbering::NONE {
            *new = self.chosen.len() as u32;
            self.chosen.push(window);
        }
        *new
    }
}

impl Distinct {
    /// Finds the distinct windows of `images`.
    pub(crate) fn find<P: Copy + Into<u32>>(&mut self, windows: &Windows, images: &[P]) {
        self.pixels.clear();
        self.which.clear();
        self.packed.clear();
        self.table.clear();
        self.before.clear();
        let largest = images.iter().fold(0, |largest, &pixel| pixel.into().max(largest));
        let packing = Packing::of(largest, windows.len());
        let packed = windows.packed();
        for image in images.chunks_exact(windows.pixels) {
            windows.pack(packing, image, &mut self.image);
            let above = self.which.len().saturating_sub(windows.count());
            for (position, place) in windows.places.iter().enumerate() {
                // Usually the window equals the one at the same place in the previous image.
                let mut words = (0..packing.words).map(|word| word * packed + place);
                let is_as_before = !self.before.is_empty()
                    && words.all(|word| self.image[word] == self.before[word]);
                let which = match is_as_before {
                    true => self.which[above + position],
                    false => self.number_of(windows, packing, image, position),
                };
                self.which.push(which);
            }
            std::mem::swap(&mut self.image, &mut self.before);
        }
    }

    /// Returns the number of a window of the image, assigning a new one if the window has not been seen before.
    fn number_of<P: Copy + Into<u32>>(
        &mut self,
        windows: &Windows,
        packing: Packing,
        image: &[P],
        position: usize,
    ) -> u32 {
        let Distinct { pixels, packed, table, image: words, .. } = self;
        let place = windows.places[position];
        let window = (0..packing.words).map(|word| words[word * windows.packed() + place]);
        let of = |known: &u32| packed[*known as usize * packing.words..][..packing.words].iter();
        let hash = hash(window.clone());
        if let Some(&known) = table.find(hash, |known| of(known).copied().eq(window.clone())) {
            return known;
        }
        let number = (pixels.len() / windows.len()) as u32;
        table.insert_unique(hash, number, |known| self::hash(of(known).copied()));
        packed.extend(window);
        pixels.extend(windows.pixels_of(image, position));
        number
    }

    /// Selects the windows of some images from `of`, with the same result as [`Distinct::find`] on these images
    /// alone. `below` is the selection in the previous layer, whose windows are the pixels of this layer.
    pub(crate) fn choose(
        &mut self,
        windows: &Windows,
        of: &Distinct,
        images: &[u32],
        below: Option<&Distinct>,
    ) {
        let Distinct { pixels, which, numbering, .. } = self;
        numbering.begin(of.pixels.len() / windows.len());
        which.clear();
        for &image in images {
            let of_image = &of.which[image as usize * windows.count()..][..windows.count()];
            which.extend(of_image.iter().map(|&window| numbering.number(window)));
        }
        pixels.clear();
        for &window in &numbering.chosen {
            let seen = &of.pixels[window as usize * windows.len()..][..windows.len()];
            match below {
                None => pixels.extend(seen),
                Some(Distinct { numbering, .. }) => {
                    pixels.extend(seen.iter().map(|&pixel| numbering.new[pixel as usize]));
                }
            }
        }
    }

    /// Writes the input of each distinct window to `input`. `outputs` holds `channels` numbers for each distinct
    /// pixel.
    pub(crate) fn gather(&self, outputs: &[f32], channels: usize, input: &mut Vec<f32>) {
        input.resize(self.pixels.len() * channels, 0.0);
        for (&pixel, input) in self.pixels.iter().zip(input.chunks_exact_mut(channels)) {
            let numbers = outputs[pixel as usize * channels..][..channels].as_chunks::<CHUNK>();
            let (chunks, rest) = input.as_chunks_mut::<CHUNK>();
            chunks.iter_mut().zip(numbers.0).for_each(|(chunk, numbers)| *chunk = *numbers);
            rest.iter_mut().zip(numbers.1).for_each(|(number, found)| *number = *found);
        }
    }

    /// Adds the numbers of every window of every image to those of its distinct window.
    pub(crate) fn sum(&self, numbers: &[f32], channels: usize, sums: &mut [f32]) {
        add_at(&self.which, numbers, channels, sums);
    }

    /// Adds the input gradient of each distinct window to the gradients of its pixels.
    pub(crate) fn spread(&self, input: &[f32], channels: usize, outputs: &mut [f32]) {
        add_at(&self.pixels, input, channels, outputs);
    }
}

/// Adds each row of numbers to the row of sums at its place.
fn add_at(places: &[u32], numbers: &[f32], width: usize, sums: &mut [f32]) {
    for (&place, numbers) in places.iter().zip(numbers.chunks_exact(width)) {
        let sums = &mut sums[place as usize * width..][..width];
        sums.iter_mut().zip(numbers).for_each(|(sum, number)| *sum += number);
    }
}

fn hash(words: impl Iterator<Item = u64>) -> u64 {
    let mut hasher = FxHasher::default();
    words.for_each(|word| hasher.write_u64(word));
    hasher.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_windows_are_one() {
        // Two images of 3 x 3. The 2 x 2 windows of the second one are all equal.
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
    fn what_is_chosen_is_as_if_found_alone() {
        let images: [[u8; 9]; 4] =
            [[0, 1, 0, 1, 0, 1, 0, 1, 0], [2; 9], [0; 9], [0, 0, 0, 0, 1, 0, 1, 0, 1]];
        let windows = [Windows::square(1, [3, 3], 2, 1), Windows::whole([2, 2])];
        let find = |images: &[u8]| {
            let mut found = [Distinct::default(), Distinct::default()];
            found[0].find(&windows[0], images);
            let which = found[0].which.clone();
            found[1].find(&windows[1], &which);
            found
        };
        let all = find(images.as_flattened());
        let mut chosen = [Distinct::default(), Distinct::default()];
        for rows in [&[3, 1, 3][..], &[0], &[1, 2, 0, 3]] {
            let alone = find(&rows.iter().flat_map(|&row| images[row]).collect::<Vec<_>>());
            let rows: Vec<u32> = rows.iter().map(|&row| row as u32).collect();
            let [below, above] = &mut chosen;
            below.choose(&windows[0], &all[0], &rows, None);
            above.choose(&windows[1], &all[1], &rows, Some(below));
            for (chosen, alone) in chosen.iter().zip(&alone) {
                assert_eq!((&chosen.pixels, &chosen.which), (&alone.pixels, &alone.which));
            }
        }
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
