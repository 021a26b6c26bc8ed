//! A grasp log in, shape and poses out.
