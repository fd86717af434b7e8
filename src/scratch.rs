//! Scratch files: temporary storage for values that do not fit into the memory limit.
//!
//! In: values, and a folder with enough space. Out: any part of these values. Cost: the system's file cache, some GB/s
//! while it has space. Where the system supports it, the file has no name, so the system deletes it when the process
//! ends, even after a crash.

use crate::error::{Error, Result};
use bytemuck::Pod;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// The memory limit, and the folder for values beyond it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MemoryLimit {
    /// Peak memory of the process, in bytes. Runs that need more are refused.
    pub bytes: u64,
    /// The folder of the scratch file.
    pub folder: PathBuf,
}

impl MemoryLimit {
    /// Memory, in bytes, for the program, its tables, and what the allocator keeps between stages. Measured; the memory
    /// of worker threads is not included.
    pub const PROGRAM: u64 = 24 << 20;

    /// Bytes available for pixels.
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
    /// Creates an empty scratch file in `folder`.
    ///
    /// # Errors
    /// [`Error::Scratch`] if the file cannot be created.
    pub fn in_folder(folder: &Path) -> Result<Arc<Self>> {
        // `Path::parent` of a file name without a folder is the empty path, which here means the current folder.
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        let folder = folder.to_owned();
        match tempfile::tempfile_in(&folder) {
            Ok(file) => Ok(Arc::new(Scratch { folder, file: Mutex::new(file) })),
            Err(source) => Err(Error::Scratch { folder, source }),
        }
    }

    /// Appends `values` to the file.
    ///
    /// # Errors
    /// [`Error::Scratch`] if they cannot be written, for example because the disk is full.
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
        // Every access seeks first, so the file can still be used after another thread panicked during its access.
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        work(&mut file).map_err(|source| Error::Scratch { folder: self.folder.clone(), source })
    }
}

/// Values in a scratch file.
#[derive(Debug, Clone)]
pub struct Kept<T> {
    scratch: Arc<Scratch>,
    /// Offset of the first value, in bytes.
    at: u64,
    count: usize,
    kind: std::marker::PhantomData<T>,
}

impl<T: Pod> Kept<T> {
    /// The number of values.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Overwrites the values with `values`.
    ///
    /// # Errors
    /// [`Error::Scratch`] if they cannot be written.
    ///
    /// # Panics
    /// If the number of values differs.
    pub fn replace(&self, values: &[T]) -> Result<()> {
        assert_eq!(values.len(), self.count);
        self.scratch.with_file(|file| {
            file.seek(SeekFrom::Start(self.at))?;
            file.write_all(bytemuck::cast_slice(values))
        })
    }

    /// Reads the values of `range`.
    ///
    /// # Errors
    /// [`Error::Scratch`] if they cannot be read.
    ///
    /// # Panics
    /// If `range` exceeds the number of values.
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
