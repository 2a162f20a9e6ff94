//! The sources room: finds stars in a frame: level, smooth, peaks, centroids, photometry.
