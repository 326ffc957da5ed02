//! Where the windows of an image lie, and how they are packed to be compared.
//!
//! An image is a row of numbers that say what its pixels are: classes of cells, or which distinct window
//! of the layer before.

/// Where the windows of an image lie.
#[derive(Clone, Debug)]
pub(crate) struct Windows {
    /// Pixels of an image, all frames together.
    pub(super) pixels: usize,
    /// Pixels of a line of it.
    width: usize,
    /// Where the pixels of a window lie, from its first.
    window: Vec<usize>,
    /// Pixels from one window to the next.
    step: usize,
    /// How many there are, one below another and beside another.
    pub(crate) size: [usize; 2],
    /// Where each lies among the packed ones.
    pub(super) places: Vec<usize>,
}

/// How the pixels of a window are packed: as many words as they fill.
#[derive(Clone, Copy)]
pub(super) struct Packing {
    /// Bits of a pixel.
    bits: u32,
    /// Pixels of a word.
    pixels: usize,
    /// Words of a window.
    pub(super) words: usize,
}

impl Packing {
    /// Of windows of so many pixels, none of which is larger than `largest`.
    pub(super) fn of(largest: u32, pixels: usize) -> Packing {
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
    pub(super) fn count(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// The pixels of a window of an image.
    pub(super) fn pixels_of<P: Copy + Into<u32>>(
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
    pub(super) fn packed(&self) -> usize {
        self.size[0] * self.line()
    }

    /// Packs the windows of an image: the first word of each, then the second of each, and so on.
    pub(super) fn pack<P: Copy + Into<u32>>(
        &self,
        packing: Packing,
        image: &[P],
        packed: &mut Vec<u64>,
    ) {
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
