//! Frames that a GPU renders while the host prepares the next ones.

use shaders::arrays::bytes::{Bytes, StartedBytes, to_bytes};
use shaders::geometry::camera::PinholeCamera;
use shaders::rasteriser;

use super::{Player, require_finite};
use crate::method::too_large;

/// A frame of which everything has been submitted: its render, the conversion to bytes and their copy to the host.
pub struct StartedFrame {
    time_secs: f64,
    camera: PinholeCamera,
    colors: StartedBytes,
}

impl StartedFrame {
    /// Blocks until the frame is on the host, so that [`Player::finish_frame`] returns without waiting for the GPU,
    /// unless it has to render the frame again.
    pub fn wait(&self) {
        self.colors.wait();
    }
}

impl Player {
    /// Submits the render of a frame to the GPU without waiting for it. On the CPU, the frame is rendered before this
    /// returns.
    ///
    /// # Errors
    /// As [`Player::render`].
    pub fn start_frame(&self, time_secs: f64, camera: &PinholeCamera) -> anyhow::Result<StartedFrame> {
        let mut tape = self.tape();
        let splats = self.splats(&mut tape, time_secs, camera)?;
        let rendered =
            rasteriser::render(&mut tape, &splats, None, camera, &self.raster_settings()).map_err(too_large)?;
        // Events of a render on the CPU; those of a GPU arrive with the frame, in `finish_frame`.
        require_finite(&tape.profile().events)?;
        let colors = tape.value(rendered.color).clone();
        let colors = StartedBytes::new(&mut tape, &colors);
        Ok(StartedFrame { time_secs, camera: *camera, colors })
    }

    /// [H, W, 3]: the colours of a frame after [`StartedFrame::wait`]. A frame with more intersections than every earlier
    /// one is rendered again.
    ///
    /// # Errors
    /// As [`Player::render`].
    pub fn finish_frame(&self, frame: StartedFrame) -> anyhow::Result<Bytes> {
        let (bytes, found) = frame.colors.finish();
        if !self.had_capacity(&found) {
            return Ok(to_bytes(&self.render(frame.time_secs, &frame.camera)?));
        }
        require_finite(&found.events)?;
        Ok(bytes)
    }
}
