//! Which windows of the images of a batch are the same.
//!
//! Windows that see the same give the same numbers, so a layer computes each distinct one once. Grids of
//! cells repeat themselves: of the windows of a minibatch a tenth or less is distinct. An image is a row
//! of numbers that say what its pixels are: classes of cells, or which distinct window of the layer
//! before; so windows are compared by a few numbers each, whatever they see in the end.

use hashbrown::HashTable;
use rustc_hash::FxHasher;
use std::hash::Hasher;

/// Numbers that are copied at a time.
const CHUNK: usize = 8;

/// Where the windows of an image lie.
#[derive(Clone, Debug)]
pub(crate) struct Windows {
    /// Pixels of an image, all frames together.
    pixels: usize,
    /// Pixels of a line of it.
    width: usize,
    /// Where the pixels of a window lie, from its first.
    window: Vec<usize>,
    /// Pixels from one window to the next.
    step: usize,
    /// How many there are, one below another and beside another.
    pub(crate) size: [usize; 2],
    /// Where each lies among the packed ones.
    places: Vec<usize>,
}

/// The distinct windows of a batch of images, in order of their first appearance.
#[derive(Clone, Debug, Default)]
pub(crate) struct Distinct {
    /// The pixels of one after another.
    pub(crate) pixels: Vec<u32>,
    /// Which of them every window of every image is.
    pub(crate) which: Vec<u32>,
    /// The pixels of one after another, packed.
    packed: Vec<u64>,
    table: HashTable<u32>,
    /// The windows of an image, packed, and those of the image before.
    image: Vec<u64>,
    before: Vec<u64>,
}

/// How the pixels of a window are packed: as many words as they fill.
#[derive(Clone, Copy)]
struct Packing {
    /// Bits of a pixel.
    bits: u32,
    /// Pixels of a word.
    pixels: usize,
    /// Words of a window.
    words: usize,
}

impl Packing {
    /// Of windows of so many pixels, none of which is larger than `largest`.
    fn of(largest: u32, pixels: usize) -> Packing {
        let bits = (u32::BITS - largest.leading_zeros()).max(1);
        let of_word = (u64::BITS / bits) as usize;
        Packing { bits, pixels: of_word, words: pixels.div_ceil(of_word) }
    }
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
        let square = |first: usize| {
            (0..side).flat_map(move |y| (0..side).map(move |x| first + y * width + x))
        };
        let size = [height, width].map(|pixels| (pixels - side) / step + 1);
        let line = (size[1] - 1) * step + 1;
        let places = (0..size[0]).flat_map(|y| (0..size[1]).map(move |x| y * line + x * step));
        Windows {
            pixels: frames * height * width,
            width,
            window: (0..frames).flat_map(|frame| square(frame * height * width)).collect(),
            step,
            size,
            places: places.collect(),
        }
    }

    /// One window that sees the whole image.
    pub(crate) fn whole([height, width]: [usize; 2]) -> Windows {
        let pixels = height * width;
        Windows {
            pixels,
            width,
            window: (0..pixels).collect(),
            step: 1,
            size: [1, 1],
            places: vec![0],
        }
    }

    /// Pixels of a window.
    pub(crate) fn len(&self) -> usize {
        self.window.len()
    }

    /// Windows of an image.
    fn count(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// The pixels of a window of an image.
    fn pixels_of<P: Copy + Into<u32>>(
        &self,
        image: &[P],
        position: usize,
    ) -> impl Iterator<Item = u32> {
        let [y, x] = [position / self.size[1], position % self.size[1]];
        let image = &image[(y * self.width + x) * self.step..];
        self.window.iter().map(|&offset| image[offset].into())
    }

    /// Windows of a line if they were one pixel apart: so many are packed, for a processor packs many at a
    /// time and picks none.
    fn line(&self) -> usize {
        (self.size[1] - 1) * self.step + 1
    }

    /// How many windows are packed.
    fn packed(&self) -> usize {
        self.size[0] * self.line()
    }

    /// Packs the windows of an image: the first word of each, then the second of each, and so on.
    fn pack<P: Copy + Into<u32>>(&self, packing: Packing, image: &[P], packed: &mut Vec<u64>) {
        let Packing { bits, pixels, words } = packing;
        packed.clear();
        packed.resize(words * self.packed(), 0);
        let word_by_word = self.window.chunks(pixels).zip(packed.chunks_exact_mut(self.packed()));
        for (offsets, words) in word_by_word {
            for (y, line) in words.chunks_exact_mut(self.line()).enumerate() {
                for &offset in offsets {
                    let pixels = &image[y * self.step * self.width + offset..][..line.len()];
                    for (word, &pixel) in line.iter_mut().zip(pixels) {
                        *word = *word << bits | u64::from(pixel.into());
                    }
                }
            }
        }
    }
}

impl Distinct {
    /// Finds the distinct windows of images.
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
                // Most often it is what the image before had in the same place.
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

    /// The number of a window of the image, which is a new one if it has not been seen.
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
