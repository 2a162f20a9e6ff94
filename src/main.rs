//! The program `stars`: everything is in the library.

fn main() -> std::process::ExitCode {
    stars::cli::main()
}
