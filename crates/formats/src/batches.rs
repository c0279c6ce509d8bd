//! Text of many frames, made on several cores and written in order.

use std::io;

use rayon::prelude::*;

/// Frames that one core makes text of at a time, and such batches that wait to be written.
const BATCH: usize = 512;
const WAITING: usize = 16;

/// Writes the text that `text` appends for each frame, in order. The same bytes as one by one.
///
/// # Errors
/// Those of `out`.
pub(crate) fn write_each<T: Sync>(
    frames: &[T],
    out: &mut dyn io::Write,
    text: impl Fn(&mut Vec<u8>, usize, &T) + Sync,
) -> io::Result<()> {
    let mut first = 0;
    // Room that is kept: fresh memory costs more than the text that goes there.
    let mut texts = vec![Vec::new(); WAITING.min(frames.len().div_ceil(BATCH))];
    for many in frames.chunks(BATCH * WAITING) {
        let batches = many.par_chunks(BATCH).enumerate();
        texts.par_iter_mut().zip(batches).for_each(|(bytes, (batch, frames))| {
            bytes.clear();
            let numbered = frames.iter().enumerate();
            numbered.for_each(|(n, frame)| text(bytes, first + batch * BATCH + n, frame));
        });
        let mut made = texts.iter().take(many.len().div_ceil(BATCH));
        made.try_for_each(|bytes| out.write_all(bytes))?;
        first += many.len();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_in_order() {
        for count in [0, 1, BATCH, BATCH * WAITING + 3, 3 * BATCH * WAITING] {
            let frames: Vec<usize> = (0..count).map(|n| n * 3).collect();
            let line = |out: &mut Vec<u8>, n: usize, frame: &usize| {
                out.extend(format!("{n} {frame}\n").into_bytes())
            };
            let (mut found, mut expected) = (Vec::new(), Vec::new());
            write_each(&frames, &mut found, line).unwrap();
            frames.iter().enumerate().for_each(|(n, frame)| line(&mut expected, n, frame));
            assert!(found == expected, "{count}");
        }
    }
}
