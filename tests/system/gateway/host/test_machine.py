from gateway.host.machine import run_to_end


def test_a_program_says_why_it_failed() -> None:
    """In its last line; one that is not there, in the system's words."""
    assert run_to_end(["true"]) == ""
    assert run_to_end(["sh", "-c", "echo one >&2; echo two >&2; exit 3"]) == "two"
    assert run_to_end(["sh", "-c", "exit 3"]) == "exit code 3"
    assert run_to_end(["no-such-program"]) == "no such file or directory"
