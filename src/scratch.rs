//! Scratch: values that do not fit into the memory allowed, on disk for as long as they are needed.
//!
//! In: values, and a folder with room for them. Out: any part of them again. Cost: that of the system's file cache, some GB/s while it
//! has room. The file has no name (where the system can do so): it is gone with the process, however that ends.

use crate::error::{Error, Result};
use bytemuck::Pod;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// How much memory may be used, and where the rest goes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MemoryLimit {
    /// Bytes, of the whole process at its peak. What cannot be done within it is refused.
    pub bytes: u64,
    /// The folder of the scratch file.
    pub folder: PathBuf,
}

impl MemoryLimit {
    /// Bytes that the program and its tables take, and what the allocator keeps from stage to stage, beside those of the threads that compute:
    /// measured.
    pub const PROGRAM: u64 = 24 << 20;

    /// What is left for pixels.
    pub fn for_pixels(&self) -> u64 {
        self.bytes.saturating_sub(MemoryLimit::PROGRAM)
    }
}

/// A scratch file.
#[derive(Debug)]
pub struct Scratch {
    folder: PathBuf,
    file: Mutex<File>,
}

impl Scratch {
    /// An empty one in `folder`.
    ///
    /// # Errors
    /// [`Error::Scratch`].
    pub fn in_folder(folder: &Path) -> Result<Arc<Self>> {
        // The folder of a file that is named without one.
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        let file = tempfile::tempfile_in(folder);
        let file = file.map_err(|source| Error::Scratch { folder: folder.to_owned(), source })?;
        Ok(Arc::new(Scratch { folder: folder.to_owned(), file: Mutex::new(file) }))
    }

    /// Puts `values` behind what is there.
    ///
    /// # Errors
    /// [`Error::Scratch`], as when the disk is full.
    pub fn put<T: Pod>(self: &Arc<Self>, values: &[T]) -> Result<Kept<T>> {
        let put = |file: &mut File| {
            let at = file.seek(SeekFrom::End(0))?;
            file.write_all(bytemuck::cast_slice(values))?;
            Ok(at)
        };
        let at = self.with_file(put)?;
        Ok(Kept { scratch: self.clone(), at, count: values.len(), kind: std::marker::PhantomData })
    }

    fn with_file<R>(&self, work: impl FnOnce(&mut File) -> std::io::Result<R>) -> Result<R> {
        // Every use begins by seeking: what a panic left of another's does not matter.
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        work(&mut file).map_err(|source| Error::Scratch { folder: self.folder.clone(), source })
    }
}

/// Values on a scratch file.
#[derive(Debug, Clone)]
pub struct Kept<T> {
    scratch: Arc<Scratch>,
    /// The place of the first, in bytes.
    at: u64,
    count: usize,
    kind: std::marker::PhantomData<T>,
}

impl<T: Pod> Kept<T> {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Puts `values` in their place.
    ///
    /// # Errors
    /// [`Error::Scratch`].
    ///
    /// # Panics
    /// When they are not as many: a fault of the caller.
    pub fn replace(&self, values: &[T]) -> Result<()> {
        assert_eq!(values.len(), self.count);
        self.scratch.with_file(|file| {
            file.seek(SeekFrom::Start(self.at))?;
            file.write_all(bytemuck::cast_slice(values))
        })
    }

    /// Those of `range`.
    ///
    /// # Errors
    /// [`Error::Scratch`].
    ///
    /// # Panics
    /// When `range` is beyond them: a fault of the caller.
    pub fn get(&self, range: Range<usize>) -> Result<Vec<T>> {
        assert!(range.start <= range.end && range.end <= self.count, "{range:?} of {}", self.count);
        let mut values = vec![T::zeroed(); range.len()];
        let from = self.at + (range.start * size_of::<T>()) as u64;
        self.scratch.with_file(|file| {
            file.seek(SeekFrom::Start(from))?;
            file.read_exact(bytemuck::cast_slice_mut(&mut values))
        })?;
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_part_comes_back_and_no_file_is_left() {
        let dir = tempfile::tempdir().unwrap();
        let scratch = Scratch::in_folder(dir.path()).unwrap();
        let codes: Vec<u16> = (0..5000).map(|i| i * 13).collect();
        let radiance: Vec<[f32; 3]> = (0..700).map(|i| [i as f32, 0.5, -1.0 / (i + 1) as f32]).collect();
        let (a, b) = (scratch.put(&codes).unwrap(), scratch.put(&radiance).unwrap());
        let c = scratch.put(&codes[..7]).unwrap();
        assert_eq!(a.get(17..4999).unwrap(), codes[17..4999]);
        assert_eq!(b.get(0..700).unwrap(), radiance);
        let other: Vec<u16> = codes.iter().map(|c| !c).collect();
        a.replace(&other).unwrap();
        assert_eq!((a.get(0..5000).unwrap(), b.get(699..700).unwrap()), (other, radiance[699..].to_vec()));
        assert_eq!((c.get(0..7).unwrap(), c.len(), a.get(9..9).unwrap().len()), (codes[..7].to_vec(), 7, 0));
        #[cfg(unix)]
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
        let error = Scratch::in_folder(&dir.path().join("nowhere")).unwrap_err().to_string();
        assert!(error.contains("nowhere") && error.contains("--max-memory"), "{error}");
    }
}
