//! The XML schemas of FMI 2.0.5 and FMI 3.0.2, in the notation of [`super::grammar`].

/// `modelDescription.xml` of FMI 2.0.5.
pub const MODEL_2: &str = "
fmiModelDescription fmiVersion!=2.0 modelName! guid! description author version copyright license
    generationTool generationDateAndTime=dateTime variableNamingConvention=flat|structured
    numberOfEventIndicators=unsignedInt
  > (ModelExchange | CoSimulation){2} UnitDefinitions? TypeDefinitions? LogCategories? DefaultExperiment?
    VendorAnnotations? ModelVariables ModelStructure
ModelExchange modelIdentifier! needsExecutionTool=boolean completedIntegratorStepNotNeeded=boolean @flags
  > SourceFiles?
CoSimulation modelIdentifier! needsExecutionTool=boolean canHandleVariableCommunicationStepSize=boolean
    canInterpolateInputs=boolean maxOutputDerivativeOrder=unsignedInt canRunAsynchronuously=boolean
    @flags
  > SourceFiles?
@flags canBeInstantiatedOnlyOncePerProcess=boolean canNotUseMemoryManagementFunctions=boolean
    canGetAndSetFMUstate=boolean canSerializeFMUstate=boolean providesDirectionalDerivative=boolean
SourceFiles > File+
File name!

UnitDefinitions > Unit+
Unit name! > BaseUnit? DisplayUnit*
BaseUnit kg=int m=int s=int A=int K=int mol=int cd=int rad=int factor=double offset=double
DisplayUnit name! factor=double offset=double

TypeDefinitions > SimpleType+
SimpleType name! description
  > (Real:RealType | Integer:IntegerType | Boolean:Untyped | String:Untyped |
    Enumeration:EnumerationType)
RealType @real
@real quantity unit displayUnit relativeQuantity=boolean min=double max=double nominal=double
    unbounded=boolean
IntegerType @integer
@integer quantity min=int max=int
Untyped > everything
EnumerationType quantity > Item+
Item name! value!=int description
LogCategories > Category+
Category name! description
DefaultExperiment startTime=double stopTime=double tolerance=double stepSize=double
VendorAnnotations > Tool+
Tool name! > one

ModelVariables > ScalarVariable+
ScalarVariable name! valueReference!=unsignedInt description
    causality=parameter|calculatedParameter|input|output|local|independent
    variability=constant|fixed|tunable|discrete|continuous initial=exact|approx|calculated
    canHandleMultipleSetPerTimeInstant=boolean
  > (Real | Integer | Boolean | String | Enumeration) Annotations:VendorAnnotations?
Real declaredType @real start=double derivative=unsignedInt reinit=boolean
Integer declaredType @integer start=int
Boolean declaredType start=boolean
String declaredType start
Enumeration declaredType! @integer start=int

ModelStructure > Outputs:Unknowns? Derivatives:Unknowns? InitialUnknowns:Unknowns?
Unknowns > Unknown+
Unknown index!=unsignedInt dependencies=[unsignedInt]
    dependenciesKind=[dependent|constant|fixed|tunable|discrete]
";

/// `modelDescription.xml` of FMI 3.0.2.
pub const MODEL_3: &str = "
fmiModelDescription fmiVersion!=version modelName! instantiationToken! description author version
    copyright license generationTool generationDateAndTime=dateTime
    variableNamingConvention=flat|structured
  > ModelExchange? CoSimulation? ScheduledExecution? UnitDefinitions? TypeDefinitions? LogCategories?
    DefaultExperiment? ModelVariables ModelStructure Annotations?
Annotations > Annotation+
Annotation type! > mixed
@interface modelIdentifier! needsExecutionTool=boolean canBeInstantiatedOnlyOncePerProcess=boolean
    canGetAndSetFMUState=boolean canSerializeFMUState=boolean providesDirectionalDerivatives=boolean
    providesAdjointDerivatives=boolean providesPerElementDependencies=boolean ...
ModelExchange @interface needsCompletedIntegratorStep=boolean providesEvaluateDiscreteStates=boolean
  > Annotations?
CoSimulation @interface canHandleVariableCommunicationStepSize=boolean fixedInternalStepSize=double
    maxOutputDerivativeOrder=unsignedInt recommendedIntermediateInputSmoothness=int
    providesIntermediateUpdate=boolean mightReturnEarlyFromDoStep=boolean
    canReturnEarlyAfterIntermediateUpdate=boolean hasEventMode=boolean
    providesEvaluateDiscreteStates=boolean
  > Annotations?
ScheduledExecution @interface > Annotations?

UnitDefinitions > Unit+
Unit name! > BaseUnit? DisplayUnit* Annotations?
BaseUnit kg=int m=int s=int A=int K=int mol=int cd=int rad=int factor=double offset=double
DisplayUnit name! factor=double offset=double inverse=boolean > Annotations?

TypeDefinitions
  > (Float32Type:FloatType | Float64Type:FloatType | Int8Type | UInt8Type | Int16Type | UInt16Type |
    Int32Type | UInt32Type | Int64Type | UInt64Type | BooleanType:PlainType | StringType:PlainType |
    BinaryType | EnumerationType | ClockType)+
@named name! description
@float unit displayUnit relativeQuantity=boolean unbounded=boolean min=double max=double nominal=double
@binary mimeType maxSize=nonNegativeInteger
@clock canBeDeactivated=boolean priority=unsignedInt
    intervalVariability!=constant|fixed|tunable|changing|countdown|triggered intervalDecimal=double
    shiftDecimal=double supportsFraction=boolean resolution=unsignedLong intervalCounter=unsignedLong
    shiftCounter=unsignedLong
FloatType @named quantity @float > Annotations?
Int8Type @named quantity min=byte max=byte > Annotations?
UInt8Type @named quantity min=unsignedByte max=unsignedByte > Annotations?
Int16Type @named quantity min=short max=short > Annotations?
UInt16Type @named quantity min=unsignedShort max=unsignedShort > Annotations?
Int32Type @named quantity min=int max=int > Annotations?
UInt32Type @named quantity min=unsignedInt max=unsignedInt > Annotations?
Int64Type @named quantity min=long max=long > Annotations?
UInt64Type @named quantity min=unsignedLong max=unsignedLong > Annotations?
PlainType @named > Annotations?
BinaryType @named @binary > Annotations?
EnumerationType @named quantity min=long max=long > Annotations? Item+
Item name! value!=long description > Annotations?
ClockType @named @clock > Annotations?
LogCategories > Category+
Category @named > Annotations?
DefaultExperiment startTime=double stopTime=double tolerance=double stepSize=double > Annotations?

ModelVariables
  > (Float32:Float | Float64:Float | Int8 | UInt8 | Int16 | UInt16 | Int32 | UInt32 | Int64 | UInt64 |
    Boolean | String | Binary | Enumeration | Clock)+
@variable name! valueReference!=unsignedInt description
    causality=parameter|calculatedParameter|input|output|local|independent|structuralParameter
    variability=constant|fixed|tunable|discrete|continuous canHandleMultipleSetPerTimeInstant=boolean
    clocks=[unsignedInt]
@value @variable intermediateUpdate=boolean previous=unsignedInt initial=exact|approx|calculated
@typed @value declaredType
Float @typed quantity @float start=[double] derivative=unsignedInt reinit=boolean
  > Annotations? Dimension* Alias:FloatAlias*
Int8 @typed quantity min=byte max=byte start=[byte] > Annotations? Dimension* Alias*
UInt8 @typed quantity min=unsignedByte max=unsignedByte start=[unsignedByte]
  > Annotations? Dimension* Alias*
Int16 @typed quantity min=short max=short start=[short] > Annotations? Dimension* Alias*
UInt16 @typed quantity min=unsignedShort max=unsignedShort start=[unsignedShort]
  > Annotations? Dimension* Alias*
Int32 @typed quantity min=int max=int start=[int] > Annotations? Dimension* Alias*
UInt32 @typed quantity min=unsignedInt max=unsignedInt start=[unsignedInt]
  > Annotations? Dimension* Alias*
Int64 @typed quantity min=long max=long start=[long] > Annotations? Dimension* Alias*
UInt64 @typed quantity min=unsignedLong max=unsignedLong start=[unsignedLong]
  > Annotations? Dimension* Alias*
Boolean @typed start=[boolean] > Annotations? Dimension* Alias*
String @typed > Annotations? Dimension* Start:StringStart* Alias*
StringStart value
Binary @typed @binary > Annotations? Dimension* Start:BinaryStart* Alias*
BinaryStart value=hexBinary
Enumeration @value quantity declaredType! min=long max=long start=[long]
  > Annotations? Dimension* Alias*
Clock @variable declaredType @clock > Annotations? Alias*
Dimension start=unsignedLong valueReference=unsignedInt
Alias @named
FloatAlias @named displayUnit

ModelStructure
  > Output:Unknown* ContinuousStateDerivative:Unknown* ClockedState:Unknown* InitialUnknown:Unknown*
    EventIndicator:Unknown*
Unknown valueReference!=unsignedInt dependencies=[unsignedInt]
    dependenciesKind=[dependent|constant|fixed|tunable|discrete]
  > Annotations?
";

/// `terminalsAndIcons/terminalsAndIcons.xml` of FMI 3.0.2.
pub const TERMINALS_AND_ICONS: &str = "
fmiTerminalsAndIcons fmiVersion!=version > GraphicalRepresentation? Terminals? Annotations?
Annotations > Annotation+
Annotation type! > mixed
GraphicalRepresentation > CoordinateSystem? Icon? Annotations?
@corners x1!=double y1!=double x2!=double y2!=double
CoordinateSystem @corners suggestedScalingFactorTo_mm!=double
Icon @corners
Terminals > Terminal+
Terminal name! matchingRule! terminalKind description
  > TerminalMemberVariable* TerminalStreamMemberVariable* Terminal* TerminalGraphicalRepresentation?
    Annotations?
TerminalMemberVariable variableName! memberName variableKind! > Annotations?
TerminalStreamMemberVariable inStreamMemberName! outStreamMemberName! inStreamVariableName!
    outStreamVariableName!
  > Annotations?
TerminalGraphicalRepresentation @corners defaultConnectionColor=[unsignedByte]
    defaultConnectionStrokeSize=double iconBaseName!
  > Annotations?
";

/// `sources/buildDescription.xml` of FMI 3.0.2.
pub const BUILD_DESCRIPTION: &str = "
fmiBuildDescription fmiVersion!=version > BuildConfiguration+ Annotations?
Annotations > Annotation+
Annotation type! > mixed
BuildConfiguration modelIdentifier! platform description > SourceFileSet* Library* Annotations?
SourceFileSet name language compiler compilerOptions
  > SourceFile+ PreprocessorDefinition* IncludeDirectory:SourceFile* Annotations?
SourceFile name! > Annotations?
PreprocessorDefinition name! optional=boolean value description > Option* Annotations?
Option value description
Library name! version external=boolean description > Annotations?
";
