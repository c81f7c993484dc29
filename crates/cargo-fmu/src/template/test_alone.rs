    #[test]
    fn a_small_error_is_controlled_by_both_gains() -> Result<(), ModelError> {
        let mut controller = Driver::<MyController>::new();
        controller.r = 10.0;
        controller.step(0.01)?;
        let (kp, ki, ts) = (0.2, 0.4, 0.01);
        assert!((controller.u - (kp + ki * ts) * 10.0).abs() < 1e-12, "{}", controller.u);
        Ok(())
    }
