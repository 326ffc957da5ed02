//! Windows of an image, and their packing for comparison.
//!
//! An image is a sequence of numbers that identify its pixels: classes of cells, or distinct windows of the
//! previous layer.

/// Positions of the windows of an image.
#[derive(Clone, Debug)]
pub(crate) struct Windows {
    /// Pixels of an image, over all frames.
    pub(super) pixels: usize,
    /// Pixels per line of the image.
    width: usize,
    /// Offsets of a window's pixels from its first pixel.
    window: Vec<usize>,
    /// Pixels from one window to the next.
    step: usize,
    /// Numbers of rows and columns of windows.
    pub(crate) size: [usize; 2],
    /// Position of each window among the packed ones.
    pub(super) places: Vec<usize>,
}

/// How the pixels of a window are packed into 64-bit words.
#[derive(Clone, Copy)]
pub(super) struct Packing {
    /// Bits per pixel.
    bits: u32,
    /// Pixels per word.
    pixels: usize,
    /// Words per window.
    pub(super) words: usize,
}

impl Packing {
    /// Returns the packing for windows of `pixels` pixels with values up to `largest`.
    pub(super) fn of(largest: u32, pixels: usize) -> Packing {
        let bits = (u32::BITS - largest.leading_zeros()).max(1);
        let of_word = (u64::BITS / bits) as usize;
        Packing { bits, pixels: of_word, words: pixels.div_ceil(of_word) }
    }
}

impl Windows {
    /// Lays out square windows with `side` pixels a side, `step` pixels apart, over `frames` consecutive images of
    /// `[height, width]`. Remainders that do not fill a window are left out.
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

    /// Lays out one window that covers the whole image.
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

    /// Returns the number of pixels in a window.
    pub(crate) fn len(&self) -> usize {
        self.window.len()
    }

    /// Returns the number of windows in an image.
    pub(super) fn count(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// Returns the pixels of a window of an image.
    pub(super) fn pixels_of<P: Copy + Into<u32>>(
        &self,
        image: &[P],
        position: usize,
    ) -> impl Iterator<Item = u32> {
        let [y, x] = [position / self.size[1], position % self.size[1]];
        let image = &image[(y * self.width + x) * self.step..];
        self.window.iter().map(|&offset| image[offset].into())
    }

    /// Returns the number of windows packed per line, as if they were one pixel apart: packing all of them is
    /// vectorized, and picking every `step`-th would not be.
    fn line(&self) -> usize {
        (self.size[1] - 1) * self.step + 1
    }

    /// Returns the number of packed windows.
    pub(super) fn packed(&self) -> usize {
        self.size[0] * self.line()
    }

    /// Packs the windows of an image: the first words of all windows, then the second words, and so on.
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
