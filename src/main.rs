//! The `cardiotwin` binary.

fn main() -> std::process::ExitCode {
    cardiotwin::cli::main()
}
