//! The service room: the actors and the channels between them.
