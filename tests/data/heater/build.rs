fn main() {
    let mut c = fmu_cc::cc::Build::new();
    c.files(["c/heater.c", "c/heater_data.c"]).include("c").flag_if_supported("-ffp-contract=off");
    fmu_cc::isolate(&c, "heater");
}
