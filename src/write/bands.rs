//! Bands: encodes rows in parallel and writes them in order.
//!
//! In: rows in order, in portions of any size. Out: fixed bands of 64 rows, encoded in parallel and written in order,
//! so that the file depends neither on the size of the portions nor on the number of threads. Cost: rows that do not
//! fill a band are copied. Memory: about one encoded band per thread, or about 16 if the disk is slower than the
//! encoder. Buffers are reused.
//!
//! Every thread takes the next band and encodes it. The thread then writes all encoded bands that are next in order,
//! unless another thread is already writing. Meanwhile, the other threads continue to encode. A thread waits for the
//! writing thread only if [`MOST_WAITING`] encoded bands wait for the disk.

use crate::error::Result;
use crate::plane::BAND_ROWS;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::io;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// If this number of encoded bands waits for the disk, the encoding threads wait too. This limits the memory and does
/// not change the bytes of the file.
const MOST_WAITING: usize = 16;

/// Divides rows into bands of 64 rows, encodes the bands in parallel and passes the encoded bytes on in order. `S` is
/// the scratch data of an encoder, which is kept from band to band to reuse its buffers.
#[derive(Debug)]
pub(super) struct Bands<P, S = ()> {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Number of rows that were passed to encoders: always the start of a band, or the height.
    done: usize,
    rest: Vec<P>,
    scratch: Mutex<Vec<S>>,
    /// Buffers of written bands, for reuse.
    spare: Vec<Vec<u8>>,
}

impl<P: Copy + Send + Sync, S: Default + Send> Bands<P, S> {
    pub(super) fn new((width, height): (usize, usize)) -> Self {
        Bands { width, height, done: 0, rest: Vec::new(), scratch: Mutex::default(), spare: Vec::new() }
    }

    /// Adds `rows`. `encode(first row, pixels, scratch, out)` encodes one band into the empty `out`. `sink` receives
    /// the `out` of every band, in order, with the value that `encode` returned for the band. The first error of
    /// `sink` ends the work.
    pub(super) fn push<R: Send>(
        &mut self,
        mut rows: &[P],
        encode: impl Fn(usize, &[P], &mut S, &mut Vec<u8>) -> R + Sync,
        sink: impl FnMut(&[u8], R) -> Result<()> + Send,
    ) -> Result<()> {
        let band = BAND_ROWS * self.width;
        let missing = (self.height - self.done) * self.width - self.rest.len();
        assert!(
            rows.len().is_multiple_of(self.width) && rows.len() <= missing,
            "only complete rows can be written, and only as many as the picture has"
        );
        let last = rows.len() == missing;
        let mut filled = Vec::new();
        if !self.rest.is_empty() {
            let (fill, further) = rows.split_at(rows.len().min(band - self.rest.len()));
            self.rest.extend_from_slice(fill);
            rows = further;
            if self.rest.len() < band && !last {
                return Ok(());
            }
            filled = std::mem::take(&mut self.rest);
        }
        let (whole, rest) = rows.split_at(if last { rows.len() } else { rows.len() / band * band });
        let mut bands: Vec<(usize, &[P])> = Vec::with_capacity(whole.len() / band.max(1) + 2);
        for pixels in filled.chunks(band).chain(whole.chunks(band)) {
            bands.push((self.done, pixels));
            self.done += pixels.len() / self.width;
        }
        self.encode_all(&bands, encode, sink)?;
        filled.clear();
        self.rest = filled;
        self.rest.extend_from_slice(rest);
        Ok(())
    }

    fn encode_all<R: Send>(
        &mut self,
        bands: &[(usize, &[P])],
        encode: impl Fn(usize, &[P], &mut S, &mut Vec<u8>) -> R + Sync,
        sink: impl FnMut(&[u8], R) -> Result<()> + Send,
    ) -> Result<()> {
        let line = Line {
            taken: AtomicUsize::new(0),
            queue: Mutex::new(Queue { next: 0, ready: BTreeMap::new(), spare: std::mem::take(&mut self.spare) }),
            sink: Mutex::new((sink, Ok(()))),
        };
        let scratch = &self.scratch;
        let worker = |_| {
            let mut own = locked(scratch).pop().unwrap_or_default();
            loop {
                let number = line.taken.fetch_add(1, Ordering::Relaxed);
                let Some(&(first, pixels)) = bands.get(number) else { break };
                let mut out = line.buffer();
                let said = encode(first, pixels, &mut own, &mut out);
                line.hand_on(number, out, said);
            }
            locked(scratch).push(own);
        };
        let workers = rayon::current_num_threads().min(bands.len());
        (0..workers).into_par_iter().with_max_len(1).for_each(worker);
        let (outcome, spare) = line.end();
        self.spare = spare;
        outcome
    }

    /// Checks that all rows were added.
    pub(super) fn complete(&self) -> io::Result<()> {
        if self.done == self.height {
            return Ok(());
        }
        Err(io::Error::other(format!(
            "only {} of the {} rows of pixels were written",
            self.done + self.rest.len() / self.width.max(1),
            self.height
        )))
    }
}

/// Encoded bands waiting for the disk.
struct Line<R, F> {
    /// Number of bands that were started.
    taken: AtomicUsize,
    queue: Mutex<Queue<R>>,
    /// The sink, and the result so far; locked by the thread that writes.
    sink: Mutex<(F, Result<()>)>,
}

/// Encoded bands by number; `next` is the number of the band to be written next.
struct Queue<R> {
    next: usize,
    ready: BTreeMap<usize, (Vec<u8>, R)>,
    spare: Vec<Vec<u8>>,
}

impl<R, F: FnMut(&[u8], R) -> Result<()>> Line<R, F> {
    /// Returns an empty buffer, reused if possible.
    fn buffer(&self) -> Vec<u8> {
        let mut buffer = locked(&self.queue).spare.pop().unwrap_or_default();
        buffer.clear();
        buffer
    }

    /// Queues an encoded band. Then writes the bands that are next in order, unless another thread is writing; waits
    /// for that thread only if [`MOST_WAITING`] bands are queued.
    fn hand_on(&self, number: usize, bytes: Vec<u8>, said: R) {
        let waiting = {
            let mut queue = locked(&self.queue);
            queue.ready.insert(number, (bytes, said));
            queue.ready.len()
        };
        if waiting >= MOST_WAITING {
            self.write(&mut locked(&self.sink));
        } else if let Ok(mut sink) = self.sink.try_lock() {
            self.write(&mut sink);
        }
    }

    fn write(&self, (sink, outcome): &mut (F, Result<()>)) {
        loop {
            let (bytes, said) = {
                let mut queue = locked(&self.queue);
                let next = queue.next;
                let Some(band) = queue.ready.remove(&next) else { return };
                queue.next += 1;
                band
            };
            if outcome.is_ok() {
                *outcome = sink(&bytes, said);
                if outcome.is_err() {
                    // This number is larger than the number of any band, so no further band is started.
                    self.taken.store(usize::MAX / 2, Ordering::Relaxed);
                }
            }
            locked(&self.queue).spare.push(bytes);
        }
    }

    /// Writes the remaining bands. Returns the result and the buffers.
    fn end(self) -> (Result<()>, Vec<Vec<u8>>) {
        self.write(&mut locked(&self.sink));
        let queue = self.queue.into_inner().unwrap_or_else(PoisonError::into_inner);
        let (_, outcome) = self.sink.into_inner().unwrap_or_else(PoisonError::into_inner);
        (outcome, queue.spare)
    }
}

/// Locks `mutex`, also after a panic in another thread. Such a panic leaves no inconsistent state that is used later.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;

    /// Portions of any size must give the same bands. A band is identified by (first row, number of rows, first
    /// value).
    #[test]
    fn bands_do_not_depend_on_the_portions() {
        let (width, height) = (3, 64 * 18 + 5);
        let pixels: Vec<u32> = (0..(width * height) as u32).collect();
        let cut = |portion: usize, threads| {
            let mut bands = Bands::<_, u32>::new((width, height));
            let mut seen = Vec::new();
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            for rows in pixels.chunks(portion * width) {
                let encode = |first: usize, p: &[u32], uses: &mut u32, out: &mut Vec<u8>| {
                    *uses += 1;
                    assert!(out.is_empty());
                    out.extend_from_slice(&(first as u32).to_le_bytes());
                    (first, p.len() / width, p[0])
                };
                let mut sink = |bytes: &[u8], band: (usize, usize, u32)| {
                    assert_eq!(bytes, (band.0 as u32).to_le_bytes());
                    seen.push(band);
                    Ok(())
                };
                pool.install(|| bands.push(rows, encode, &mut sink)).unwrap();
            }
            bands.complete().unwrap();
            assert!(locked(&bands.scratch).len() <= threads && bands.spare.len() <= 19);
            assert_eq!(locked(&bands.scratch).iter().sum::<u32>(), 19, "scratch data are kept from push to push");
            seen
        };
        let expected: Vec<_> =
            (0..19).map(|b| (64 * b, if b == 18 { 5 } else { 64 }, (64 * b * width) as u32)).collect();
        for threads in [1, 2, 7] {
            for portion in [1, 7, 63, 64, 65, 130, 300, height] {
                assert_eq!(cut(portion, threads), expected, "{portion} rows at a time on {threads} threads");
            }
        }
    }

    /// Returns the error of the first band, in order, that cannot be written; no later band is written.
    #[test]
    fn the_first_error_ends_it() {
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut bands = Bands::<u8>::new((1, 64 * 30));
            let mut written = 0;
            let outcome = pool.install(|| {
                let encode = |first: usize, _: &[u8], (): &mut (), _: &mut Vec<u8>| first / 64;
                bands.push(&[0; 64 * 30], encode, |_, number| {
                    if number >= 5 {
                        return Err(Error::Write { path: number.to_string().into(), source: io::Error::other("full") });
                    }
                    written += 1;
                    Ok(())
                })
            });
            assert!(matches!(outcome, Err(Error::Write { path, .. }) if path.to_str() == Some("5")));
            assert_eq!(written, 5);
        }
    }

    #[test]
    fn missing_rows_are_an_error() {
        let mut bands = Bands::<u8>::new((2, 100));
        bands.push(&[0u8; 140], |_, _, (), _| (), |_, ()| Ok(())).unwrap();
        assert_eq!(bands.complete().unwrap_err().to_string(), "only 70 of the 100 rows of pixels were written");
    }
}
