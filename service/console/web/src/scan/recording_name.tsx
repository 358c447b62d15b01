import { useState } from "preact/hooks";
import { api, resultOf } from "../net/api";
import { t } from "../texts/translate";
import { useQuery } from "../ui/use_query";

/** The name of a recording, after a comma; empty as long as it is unknown. */
export function RecordingName({ id }: { id: string }) {
  const [name, setName] = useState<string | null>(null);
  useQuery(
    () => resultOf(api.GET("/api/recordings/{id}", { params: { path: { id } } })),
    (recording) => setName(recording.name),
    [id],
  );
  return name === null ? null : <>{t("scan.recording_name", { name })}</>;
}
