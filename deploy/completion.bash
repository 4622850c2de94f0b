# Completion of 'cruiser' for bash; in zsh after: autoload -U +X compinit bashcompinit && compinit && bashcompinit
# Asks the command itself for its help, so that it knows what is installed. Reads no settings, and connects to nothing.
_cruiser() {
    local current="${COMP_WORDS[COMP_CWORD]}" command="${COMP_WORDS[0]}" known=
    local -a before=("${COMP_WORDS[@]:1:$((COMP_CWORD - 1))}") named=()
    local word
    for word in "${before[@]}"; do
        [[ $word == -* ]] || named+=("$word")
    done
    # Commands; questions of review, and actions of others; then only their flags: all else is a file or a name.
    if [[ $current == -* ]]; then
        known=$("$command" help "${named[@]:0:2}" 2>/dev/null || "$command" help "${named[@]:0:1}" 2>/dev/null)
        known=$(grep -oE -- '(^|[ [,])--[a-z][a-z-]+' <<<"$known" | grep -oE -- '--.*' | sort -u)
    elif ((${#named[@]} == 0)); then
        known=$("$command" --help 2>/dev/null | sed -nE 's/^  ([a-z]+)  .*/\1/p')
    elif ((${#named[@]} == 1)); then
        known=$("$command" help "${named[0]}" 2>/dev/null | sed -nE 's/^    ([a-z_]+)( .*|$)/\1/p')
    fi
    COMPREPLY=($(compgen -W "$known" -- "$current"))
}
complete -o default -F _cruiser cruiser
