//! Decoding ahead on another thread.

use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::{Builder, JoinHandle};

use super::{ClipInfo, Frame, FrameError, FrameSource};

/// Runs a source on another thread, at most a given number of frames ahead of the reader.
///
/// Frames, their order and any error are those of the source itself.
pub struct Prefetch {
    info: ClipInfo,
    frames: Option<Receiver<Result<Frame, FrameError>>>,
    thread: Option<JoinHandle<()>>,
}

impl Prefetch {
    /// Starts reading `source`, keeping at most `ahead` decoded frames (at least one).
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn new(mut source: impl FrameSource + 'static, ahead: usize) -> Result<Self, FrameError> {
        let info = source.info().clone();
        Self::spawn(info, ahead, move |send| {
            loop {
                match source.next_frame() {
                    Ok(Some(frame)) => {
                        if !send(Ok(frame)) {
                            return;
                        }
                    }
                    Ok(None) => return,
                    Err(error) => {
                        send(Err(error));
                        return;
                    }
                }
            }
        })
    }

    /// Starts `produce`, which hands over frames until it is done or is told `false`: no one listens.
    pub(super) fn spawn(
        info: ClipInfo,
        ahead: usize,
        produce: impl FnOnce(&dyn Fn(Result<Frame, FrameError>) -> bool) + Send + 'static,
    ) -> Result<Self, FrameError> {
        let (sender, frames) = sync_channel(ahead.max(1));
        let thread = Builder::new()
            .name("frames".to_owned())
            .spawn(move || produce(&|item| sender.send(item).is_ok()))
            .map_err(|source| FrameError::Io { path: "decoding thread".to_owned(), source })?;
        Ok(Self { info, frames: Some(frames), thread: Some(thread) })
    }

    fn close(&mut self) -> bool {
        // The sender fails once the receiver is gone, so the thread ends soon.
        self.frames = None;
        self.thread.take().is_none_or(|thread| thread.join().is_ok())
    }
}

impl FrameSource for Prefetch {
    fn info(&self) -> &ClipInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        let Some(frames) = &self.frames else { return Ok(None) };
        match frames.recv() {
            Ok(Ok(frame)) => Ok(Some(frame)),
            Ok(Err(error)) => {
                self.close();
                Err(error)
            }
            Err(_) => {
                if self.close() {
                    Ok(None)
                } else {
                    Err(FrameError::Malformed {
                        path: self.info.format.clone(),
                        what: "the decoder broke down on this input".to_owned(),
                    })
                }
            }
        }
    }
}

impl Drop for Prefetch {
    fn drop(&mut self) {
        self.close();
    }
}
