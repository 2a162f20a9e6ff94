//! The camera room: where frames come from: a directory of images, a simulated sky.
