//! The interface of the library Open Image Denoise.
#![allow(unsafe_code, reason = "a library in C has no other interface; each block says why it is sound")]

use std::ffi::{CStr, c_char, c_int, c_void};
use std::ptr;

use crate::{Error, Installation};

type Device = *mut c_void;
type Filter = *mut c_void;
type Monitor = unsafe extern "C" fn(*mut c_void, f64) -> bool;
type SetImage =
    unsafe extern "C" fn(Filter, *const c_char, *mut c_void, c_int, usize, usize, usize, usize, usize);

/// The constant `OIDN_DEVICE_TYPE_CPU` of the library. The CPU is always used, since the output of a GPU would
/// depend on its model.
const CPU: c_int = 1;
/// The constant `OIDN_FORMAT_FLOAT3` of the library.
const FLOAT3: c_int = 3;
/// Approximate maximum memory that the library uses, in bytes. Pictures that need more are filtered in tiles.
pub const MEMORY_BYTES: u64 = 1 << 30;

/// The loaded library: its version, and the functions that this crate calls, as declared in
/// `OpenImageDenoise/oidn.h` of version 2.
pub struct Library {
    version: String,
    new_device: unsafe extern "C" fn(c_int) -> Device,
    set_device_int: unsafe extern "C" fn(Device, *const c_char, c_int),
    commit_device: unsafe extern "C" fn(Device),
    release_device: unsafe extern "C" fn(Device),
    device_error: unsafe extern "C" fn(Device, *mut *const c_char) -> c_int,
    new_filter: unsafe extern "C" fn(Device, *const c_char) -> Filter,
    set_image: SetImage,
    set_bool: unsafe extern "C" fn(Filter, *const c_char, bool),
    set_int: unsafe extern "C" fn(Filter, *const c_char, c_int),
    set_monitor: unsafe extern "C" fn(Filter, Option<Monitor>, *mut c_void),
    commit_filter: unsafe extern "C" fn(Filter),
    execute_filter: unsafe extern "C" fn(Filter),
    release_filter: unsafe extern "C" fn(Filter),
}

/// Auxiliary images that guide the filter. Each has three floats per pixel, like the picture itself.
#[derive(Debug, Clone, Copy)]
pub struct Surfaces<'a> {
    /// Reflectance, from 0 to 1.
    pub albedo: &'a [f32],
    /// Surface normals; zero vectors where there is no surface.
    pub normal: &'a [f32],
}

impl Installation {
    /// Loads the library. It stays loaded until the program ends, because its threads may still be running.
    ///
    /// # Errors
    /// If the file is not the library, or depends on other libraries that are missing.
    pub fn load(&self) -> Result<Library, Error> {
        let path = self.path.display().to_string();
        let failed = |why: libloading::Error| {
            let why = std::error::Error::source(&why).map_or_else(|| why.to_string(), ToString::to_string);
            Error::Load { path: path.clone(), why }
        };
        // SAFETY: loading runs the library's initialisers. The file lies where the administrator or the user of
        // this machine has put it, and no graph can choose its path.
        let library = unsafe { libloading::Library::new(&self.path) }.map_err(failed)?;
        macro_rules! symbol {
            // SAFETY: the types are those of the header of version 2, which the file name promises.
            ($name:literal) => {
                *unsafe { library.get($name) }.map_err(failed)?
            };
        }
        let loaded = Library {
            version: self.version.clone(),
            new_device: symbol!(b"oidnNewDevice\0"),
            set_device_int: symbol!(b"oidnSetDeviceInt\0"),
            commit_device: symbol!(b"oidnCommitDevice\0"),
            release_device: symbol!(b"oidnReleaseDevice\0"),
            device_error: symbol!(b"oidnGetDeviceError\0"),
            new_filter: symbol!(b"oidnNewFilter\0"),
            set_image: symbol!(b"oidnSetSharedFilterImage\0"),
            set_bool: symbol!(b"oidnSetFilterBool\0"),
            set_int: symbol!(b"oidnSetFilterInt\0"),
            set_monitor: symbol!(b"oidnSetFilterProgressMonitorFunction\0"),
            commit_filter: symbol!(b"oidnCommitFilter\0"),
            execute_filter: symbol!(b"oidnExecuteFilter\0"),
            release_filter: symbol!(b"oidnReleaseFilter\0"),
        };
        // The functions must outlive every use of them.
        std::mem::forget(library);
        Ok(loaded)
    }
}

impl Library {
    /// The version of the library, such as `2.3.3`.
    pub fn version(&self) -> &str {
        &self.version
    }

    /// Filters a picture on the calling thread. `colour` contains linear values, three floats per pixel, row by
    /// row. `goes_on` is called repeatedly; if it returns false, the filter stops. Calls with the same library and
    /// the same type of processor give bit-identical results.
    ///
    /// # Errors
    /// If `goes_on` returns false, or the library reports an error.
    ///
    /// # Panics
    /// If the length of a slice is not `width` x `height` x 3.
    pub fn denoise(
        &self,
        [width, height]: [usize; 2],
        colour: &[f32],
        surfaces: Option<Surfaces<'_>>,
        goes_on: &(dyn Fn() -> bool + Sync),
    ) -> Result<Vec<f32>, Error> {
        let mut out = vec![0.0_f32; width * height * 3];
        let guides = surfaces.map(|of| [(c"albedo", of.albedo), (c"normal", of.normal)]);
        let given = [(c"color", colour)].into_iter().chain(guides.into_iter().flatten());
        // SAFETY: the calls are in the order that the library's documentation asks for, on a device and a filter
        // that live until the end of the block and are used by this thread alone. A device that could not be made
        // is null, which every function takes and reports. All pictures hold `width` x `height` x 3 floats, which
        // is checked, and outlive the filter; of them it writes `output` alone. The monitor is called only during
        // `execute_filter`, while the closure that its pointer leads to is alive, and may be called on any thread.
        unsafe {
            let device = (self.new_device)(CPU);
            let _device = Release(self.release_device, device);
            (self.set_device_int)(device, c"numThreads".as_ptr(), 1);
            (self.commit_device)(device);
            self.check(device)?;
            let filter = (self.new_filter)(device, c"RT".as_ptr());
            let _filter = Release(self.release_filter, filter);
            let image = |name: &CStr, samples: *mut f32| {
                (self.set_image)(filter, name.as_ptr(), samples.cast(), FLOAT3, width, height, 0, 0, 0);
            };
            for (name, samples) in given {
                assert_eq!(samples.len(), out.len(), "{name:?} has the size of the picture");
                image(name, samples.as_ptr().cast_mut());
            }
            image(c"output", out.as_mut_ptr());
            (self.set_bool)(filter, c"hdr".as_ptr(), true);
            (self.set_int)(filter, c"maxMemoryMB".as_ptr(), (MEMORY_BYTES >> 20) as c_int);
            (self.set_monitor)(filter, Some(monitor), ptr::from_ref(&goes_on).cast_mut().cast());
            (self.commit_filter)(filter);
            (self.execute_filter)(filter);
            self.check(device)?;
        }
        Ok(out)
    }

    /// Returns the first error that the device has reported since the last call.
    ///
    /// # Safety
    /// `device` must have been created by this library, or be null.
    unsafe fn check(&self, device: Device) -> Result<(), Error> {
        /// The constant `OIDN_ERROR_CANCELLED` of the library.
        const CANCELLED: c_int = 6;
        let mut text = ptr::null();
        // SAFETY: the caller promises the device; the text is read before the library is called again.
        let (code, why) = unsafe {
            let code = (self.device_error)(device, &raw mut text);
            let why = if text.is_null() {
                "the library gave no reason".into()
            } else {
                CStr::from_ptr(text).to_string_lossy()
            };
            (code, why)
        };
        match code {
            0 => Ok(()),
            CANCELLED => Err(Error::Stopped),
            _ => Err(Error::Failed { version: self.version.clone(), why: why.into_owned() }),
        }
    }
}

/// Calls the closure that the pointer refers to. Returns false if the filter should stop.
///
/// # Safety
/// The pointer must point to a `&(dyn Fn() -> bool + Sync)`.
unsafe extern "C" fn monitor(goes_on: *mut c_void, _: f64) -> bool {
    // SAFETY: `denoise` passes such a pointer, to a closure that outlives the filtering.
    let goes_on = unsafe { &*goes_on.cast::<&(dyn Fn() -> bool + Sync)>() };
    goes_on()
}

/// Guard that releases an object of the library when it is dropped.
struct Release(unsafe extern "C" fn(*mut c_void), *mut c_void);

impl Drop for Release {
    fn drop(&mut self) {
        // SAFETY: it was made by the library, and is released once.
        unsafe { (self.0)(self.1) }
    }
}
