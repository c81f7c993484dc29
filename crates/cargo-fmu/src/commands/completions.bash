
# The completion that `cargo` has, unless this script was sourced before.
_cargo_fmu_found=$(complete -p cargo 2>/dev/null | sed -n 's/.* -F \([^ ]*\) .*/\1/p')
[[ $_cargo_fmu_found == _cargo_fmu_after_cargo ]] || _cargo_fmu_before=$_cargo_fmu_found
_cargo_fmu_after_cargo() {
    if [[ ${COMP_WORDS[1]} == fmu && $COMP_CWORD -gt 1 ]]; then
        COMP_WORDS=(cargo_fmu "${COMP_WORDS[@]:2}")
        COMP_CWORD=$((COMP_CWORD - 1))
        _cargo_fmu cargo_fmu "$2" "$3"
    elif [[ -n $_cargo_fmu_before ]]; then
        "$_cargo_fmu_before" "$@"
    fi
}
complete -F _cargo_fmu_after_cargo -o bashdefault -o default cargo
